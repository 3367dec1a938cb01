#include "bake/not_modelled.h"

#include <algorithm>
#include <map>

#include "bake/rays/surface_sampling.h"
#include "bake/surface/patches.h"

namespace ff::bake {
namespace {

std::string nameOf(const Scene& scene, uint32_t material) {
  const std::string& name = scene.materials[material].name;
  return name.empty() ? "material " + std::to_string(material) : name;
}

// Areas by material to names, largest first.
std::vector<std::string> namesByArea(const Scene& scene, const std::map<uint32_t, double>& area) {
  std::map<std::string, double> by_name;
  for (const auto& [material, m2] : area) by_name[nameOf(scene, material)] += m2;
  std::vector<std::pair<double, std::string>> order;
  for (const auto& [name, m2] : by_name) order.emplace_back(-m2, name);
  std::sort(order.begin(), order.end());
  std::vector<std::string> names;
  for (auto& [m2, name] : order) names.push_back(std::move(name));
  return names;
}

}  // namespace

std::vector<NotModelled> notModelled(const Scene& scene) {
  std::vector<double> area(scene.materials.size());
  std::vector<uint64_t> triangles(scene.materials.size());
  double whole = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const double m2 = static_cast<double>(triangleArea(scene, t));
    area[scene.triangles[t].material] += m2;
    ++triangles[scene.triangles[t].material];
    whole += m2;
  }
  std::map<std::string, std::map<uint32_t, double>> lines;
  for (uint32_t m = 0; m < scene.materials.size(); ++m) {
    const Material& material = scene.materials[m];
    const bool passes_all = material.transmission == 1 || (material.blend && material.alpha == 0);
    if (triangles[m] == 0 && !passes_all) continue;
    for (const std::string& what : material.left_alone) lines[what][m] = area[m];
  }
  std::vector<NotModelled> out;
  for (const auto& [what, materials] : lines) {
    NotModelled& line = out.emplace_back();
    line.what = what;
    for (const auto& [m, m2] : materials) {
      line.triangles += triangles[m];
      line.area_share += whole > 0 ? m2 / whole : 0;
    }
    line.names = namesByArea(scene, materials);
  }
  for (const std::string& what : scene.left_alone) out.push_back({what, 0, 0, {}});
  return out;
}

std::optional<NotModelled> loweredAlbedos(const Scene& scene, const PatchSet& set, std::span<const uint32_t> patches) {
  if (patches.empty()) return {};
  NotModelled line;
  line.what = "albedos of surfaces that would have reflected all they see back to what they see: lowered on " +
              std::to_string(patches.size()) + (patches.size() == 1 ? " patch" : " patches");
  std::map<uint32_t, double> area;
  double lowered = 0, whole = 0;
  std::vector<uint8_t> met(scene.triangles.size());
  for (const uint32_t p : patches) {
    const Patch& patch = set.patches[p];
    lowered += static_cast<double>(patch.area_m2);
    for (uint32_t k = patch.first_triangle; k < patch.first_triangle + patch.triangles; ++k) {
      const PatchTriangle& t = set.triangles[k];
      area[scene.triangles[t.source].material] += static_cast<double>(length(cross(t.b - t.a, t.c - t.a))) / 2;
      if (!met[t.source]) ++line.triangles;
      met[t.source] = 1;
    }
  }
  for (const Patch& patch : set.patches) whole += static_cast<double>(patch.area_m2);
  line.area_share = whole > 0 ? lowered / whole : 0;
  line.names = namesByArea(scene, area);
  return line;
}

}  // namespace ff::bake
