// Materials of a document as the baker's, with the pictures that they show. Private to gltf_*.cpp.
#pragma once
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "bake/gltf_surface.h"
#include "bake/scene.h"

namespace ff::bake::gltf {

class Materials {
 public:
  Materials(const Document& document, Scene& scene, Budget& budget)
      : document_(document), scene_(scene), budget_(budget) {}

  // Number in Scene::materials of a document's material (-1: none named), read on first use.
  uint32_t number(int material);
  const UvSource& base(uint32_t number) const { return base_[number]; }
  const UvSource& emission(uint32_t number) const { return emission_[number]; }
  // The material tinted by a vertex colour, which is rounded so that there are few of them.
  uint32_t tinted(uint32_t number, Vec3 color);
  // The material as the traits want it: `number` itself where they say nothing of materials.
  uint32_t with(uint32_t number, const Traits& traits);

 private:
  uint32_t add(Material material, UvSource base, UvSource emission);
  uint32_t image(int texture, bool* repeat);
  UvSource uvSource(int tex_coord, const tinygltf::ExtensionMap& extensions) const;
  float meanMetal(int texture);

  const Document& document_;
  Scene& scene_;
  Budget& budget_;
  std::map<int, uint32_t> numbers_;
  std::map<uint32_t, uint32_t> images_;  // document's image -> Scene::images or kNone
  std::map<std::tuple<uint32_t, int, int, int>, uint32_t> tints_;
  std::map<std::tuple<uint32_t, bool, float, std::string>, uint32_t> variants_;
  std::vector<UvSource> base_, emission_;
};

}  // namespace ff::bake::gltf
