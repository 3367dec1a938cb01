// Materials of a document as the baker's, with the pictures that they show. Private to this folder.
#pragma once
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "bake/import/images.h"
#include "bake/import/primitive.h"
#include "bake/scene.h"

namespace ff::bake::gltf {

class Materials {
 public:
  Materials(const Document& document, Scene& scene, Budget& budget, uint64_t max_decoded_bytes)
      : document_(document), scene_(scene), budget_(budget), pictures_(document, scene, budget, max_decoded_bytes) {}

  // Number in Scene::materials of a document's material (-1: none named), read on first use.
  uint32_t number(int material);
  const UvSource& base(uint32_t number) const { return base_[number]; }
  const UvSource& emission(uint32_t number) const { return emission_[number]; }
  // The material as the traits want it: `number` itself where they say nothing of materials.
  uint32_t with(uint32_t number, const Traits& traits);

 private:
  uint32_t add(Material material, UvSource base, UvSource emission);
  bool repeats(int texture) const;
  UvSource uvSource(int tex_coord, const tinygltf::ExtensionMap& extensions) const;
  // Mean of a channel of a texture's picture, times `factor`; without a texture the factor. Without its picture 0, and `what`
  // is left alone.
  double scaled(double factor, int texture, size_t channel, const char* what, Material& of);
  void addSpecular(const MaterialFacts& facts, Material& out);
  void addTransmission(const MaterialFacts& facts, int base_texture, Material& out);

  const Document& document_;
  Scene& scene_;
  Budget& budget_;
  Pictures pictures_;
  std::map<int, uint32_t> numbers_;
  std::map<std::tuple<uint32_t, bool, float, std::string>, uint32_t> variants_;
  std::vector<UvSource> base_, emission_;
};

}  // namespace ff::bake::gltf
