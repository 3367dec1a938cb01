// A scene as the baker sees it: triangles in metres, in world space but for the origin, flat materials, images. No third-party types.
// Whatever leaves the importer holds: finite coordinates, vertex numbers < positions.size(), material numbers
// < materials.size(), image numbers < images.size() or kNone, no degenerate (zero-area) triangles.
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "bake/finding.h"
#include "bake/paging.h"
#include "formats/model.h"
#include "formats/result.h"
#include "formats/vec3.h"

namespace ff::bake {

inline constexpr uint32_t kNone = 0xffffffffu;
inline constexpr float kLargestDensity = 16;  // Material::density

struct Vec2 {
  float x = 0, y = 0;
};

// Linear.
struct Rgba {
  float r = 1, g = 1, b = 1, a = 1;
  Vec3 rgb() const { return {r, g, b}; }
  friend bool operator==(const Rgba&, const Rgba&) = default;
};

// 8-bit RGBA as stored; colour channels are sRGB-encoded, alpha is linear.
struct Image {
  uint32_t width = 0, height = 0;
  std::vector<uint8_t> rgba;
};

struct Material {
  std::string name;
  std::string lamp_group{};      // what is switched together if it emits; empty: the material's name
  Vec3 base_color{1, 1, 1};      // linear factor
  float alpha = 1;               // factor
  float metallic = 1;            // how much of the reflection is a mirror's; see PatchSettings::metals
  Vec3 emission;                 // radiance factor, W/(m2 sr): emissiveFactor * KHR_materials_emissive_strength
  uint32_t base_image = kNone;   // multiplies base_color and alpha; texture coordinates are Scene::uv0
  uint32_t emission_image = kNone;  // multiplies emission; Scene::uv1 (already chosen and transformed by the importer)
  bool repeat = true;            // wrap mode of both images: repeat (mirrored counts as repeat) or clamp
  bool double_sided = false;
  Vec3 specular{};               // mirror reflectance besides base_color; see PatchSettings::metals
  bool cutout = false;           // light may pass: alphaMode MASK or BLEND, or transmission; see solidity()
  float alpha_cutoff = 0.5f;     // it passes where alpha is below it; unless
  bool blend = false;            // alphaMode BLEND: alpha is the share of the light that does not pass
  float transmission = 0;        // share of the light that passes where alpha would stop it
  bool unlit = false;            // KHR_materials_unlit
  bool occlude_only = false;     // blocks light and has no patches
  float density = 1;             // of patches: 2 has them half as large; 1/kLargestDensity to kLargestDensity, rounded to a power of two
  std::vector<std::string> left_alone{};  // what the file asks of it and is not modelled, a line each: "EXTENSION: what"
};

struct Triangle {
  std::array<uint32_t, 3> v{};
  uint32_t material = 0;
};

// A run of triangles that come from one mesh at one node.
struct Object {
  uint32_t first_triangle = 0;
  uint32_t node = kNone, mesh = kNone;  // of the file
};

// What light does that comes to the back of a single-sided surface.
enum class Backs : uint8_t {
  kAbsorb,   // it ends there
  kReflect,  // as on the front: every material is double_sided
  kPass      // it goes on
};

struct Scene {
  std::string name;                 // file name without folders
  std::array<double, 3> origin{};   // m, in world space: of all coordinates here; not 0 only where the scene stands far from the world's
  PagedVector<Vec3> positions;      // m
  PagedVector<Triangle> triangles;  // counter-clockwise seen from the front (mirrored nodes are already flipped)
  PagedVector<Vec2> uv0;            // base colour, KHR_texture_transform applied; one per position, or empty
  PagedVector<Vec2> uv1;            // emission, likewise
  PagedVector<Rgba> colors;         // vertex colours, which multiply base_color and alpha; one per position, or empty
  std::vector<Material> materials;
  std::vector<Image> images;
  PagedVector<Object> objects;     // ascending; empty where nothing is known
  std::vector<std::string> node_names, mesh_names;
  Backs backs = Backs::kAbsorb;
  std::vector<formats::Light> lights;   // KHR_lights_punctual
  std::vector<std::string> left_alone;  // what is not modelled of the scene as a whole, likewise
  uint64_t without_area = 0;            // triangles that were left out because they have no area
  std::vector<FoundPlace> without_area_at;   // some of them
  std::vector<std::string> warnings;
  std::array<uint8_t, 16> content_hash{};  // XXH3-128 of the above arrays: part of the bake key
};

// A place in the world, m.
inline std::array<double, 3> inWorld(const Scene& scene, Vec3 p) {
  return {scene.origin[0] + static_cast<double>(p.x), scene.origin[1] + static_cast<double>(p.y), scene.origin[2] + static_cast<double>(p.z)};
}

}  // namespace ff::bake
