#include "bake/not_modelled.h"

#include <algorithm>
#include <map>

#include "bake/cleanup/scene_names.h"
#include "bake/rays/surface_sampling.h"
#include "bake/surface/patches.h"

namespace ff::bake {
namespace {

// Of one material.
struct Covered {
  HeaviestPlace m2;  // the middle of the largest triangle
  uint64_t triangles = 0;

  void add(double own_m2, Vec3 middle) {
    m2.add(own_m2, middle);
    ++triangles;
  }
};

std::string nameOf(const Scene& scene, uint32_t material) {
  const std::string& name = scene.materials[material].name;
  return name.empty() ? "material " + std::to_string(material) : name;
}

// One for each name, largest area first.
std::vector<FoundPlace> placesByArea(const Scene& scene, const std::map<uint32_t, Covered>& materials) {
  std::map<std::string, HeaviestPlace> by_name;
  double all = 0;
  for (const auto& [material, own] : materials) {
    by_name[nameOf(scene, material)].add(own.m2);
    all += own.m2.sum;
  }
  std::vector<FoundPlace> places;
  for (const auto& [name, sum] : by_name) {
    FoundPlace& place = places.emplace_back(std::nullopt, name, all > 0 ? sum.sum / all : 0);
    if (sum.heaviest >= 0) place.at = inWorld(scene, sum.at);
  }
  std::stable_sort(places.begin(), places.end(), [](const FoundPlace& a, const FoundPlace& b) { return a.share > b.share; });
  return places;
}

Finding findingOf(const Scene& scene, const std::string& what, const std::map<uint32_t, Covered>& materials, double whole_m2) {
  Finding finding{"not_modelled", what, 0, "triangles", 0, "surface"};
  for (const auto& [material, own] : materials) {
    finding.count += own.triangles;
    finding.share += whole_m2 > 0 ? own.m2.sum / whole_m2 : 0;
  }
  finding.places = placesByArea(scene, materials);
  return finding;
}

}  // namespace

std::vector<Finding> notModelled(const Scene& scene) {
  std::vector<Covered> of_material(scene.materials.size());
  double whole = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const double m2 = static_cast<double>(triangleArea(scene, t));
    of_material[scene.triangles[t].material].add(m2, middleOf(scene, t));
    whole += m2;
  }
  std::map<std::string, std::map<uint32_t, Covered>> lines;
  for (uint32_t m = 0; m < scene.materials.size(); ++m) {
    const Material& material = scene.materials[m];
    const bool passes_all = material.transmission == 1 || (material.blend && material.alpha == 0);
    if (of_material[m].triangles == 0 && !passes_all) continue;
    for (const std::string& what : material.left_alone) lines[what][m] = of_material[m];
  }
  std::vector<Finding> out;
  for (const auto& [what, materials] : lines) out.push_back(findingOf(scene, what, materials, whole));
  for (const std::string& what : scene.left_alone) out.push_back({"not_modelled", what});
  return out;
}

std::optional<Finding> loweredAlbedos(const Scene& scene, const PatchSet& set, std::span<const uint32_t> patches) {
  if (patches.empty()) return {};
  std::map<uint32_t, Covered> of_material;
  std::map<uint32_t, double> of_triangle;
  double lowered = 0, whole = 0;
  for (const uint32_t p : patches) {
    const Patch& patch = set.patches[p];
    lowered += static_cast<double>(patch.area_m2);
    for (uint32_t k = patch.first_triangle; k < patch.first_triangle + patch.triangles; ++k) {
      const PatchTriangle& t = set.triangles[k];
      of_triangle[t.source] += static_cast<double>(length(cross(t.b - t.a, t.c - t.a))) / 2;
    }
  }
  for (const auto& [t, m2] : of_triangle) of_material[scene.triangles[t].material].add(m2, middleOf(scene, t));
  for (const Patch& patch : set.patches) whole += static_cast<double>(patch.area_m2);
  Finding finding = findingOf(scene, "albedos of surfaces that would have reflected all they see back to what they see: lowered on " +
                              std::to_string(patches.size()) + (patches.size() == 1 ? " patch" : " patches"), of_material, 0);
  finding.share = whole > 0 ? lowered / whole : 0;
  return finding;
}

}  // namespace ff::bake
