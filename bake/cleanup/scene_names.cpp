#include "bake/cleanup/scene_names.h"

#include <fnmatch.h>

#include <algorithm>
#include <cmath>

namespace ff::bake {
namespace {

std::string named(const char* kind, const std::vector<std::string>& names, uint32_t number) {
  const std::string& name = number < names.size() ? names[number] : std::string();
  return name.empty() ? std::string(kind) + " " + std::to_string(number) : std::string(kind) + " \"" + name + "\"";
}

}  // namespace

const Object* objectOf(const Scene& scene, uint32_t triangle) {
  const auto after = std::upper_bound(scene.objects.begin(), scene.objects.end(), triangle,
                                      [](uint32_t t, const Object& object) { return t < object.first_triangle; });
  return after == scene.objects.begin() ? nullptr : &*(after - 1);
}

std::string placeOf(const Scene& scene, uint32_t triangle) {
  std::string place;
  const Object* object = objectOf(scene, triangle);
  if (object && object->node != kNone) {
    const bool by_mesh = object->mesh < scene.mesh_names.size() && !scene.mesh_names[object->mesh].empty() &&
                         (object->node >= scene.node_names.size() || scene.node_names[object->node].empty());
    place = (by_mesh ? named("mesh", scene.mesh_names, object->mesh) : named("node", scene.node_names, object->node)) + ", ";
  }
  const uint32_t m = scene.triangles[triangle].material;
  const std::string& name = scene.materials[m].name;
  return place + (name.empty() ? "material " + std::to_string(m) : "material \"" + name + "\"");
}

void PlaceSums::add(uint32_t triangle, double weight) {
  const Object* object = objectOf(scene_, triangle);
  const std::pair key(object ? object->node : kNone, scene_.triangles[triangle].material);
  const auto [at, added] = sums_.try_emplace(key, Sum{triangle, 0});
  at->second.weight += weight;
  at->second.triangle = std::min(at->second.triangle, triangle);
}

std::string PlaceSums::heaviest() const {
  constexpr size_t kMost = 3;
  std::vector<Sum> sums;
  double all = 0;
  for (const auto& [key, sum] : sums_) {
    sums.push_back(sum);
    all += sum.weight;
  }
  std::sort(sums.begin(), sums.end(), [](const Sum& a, const Sum& b) {
    return a.weight != b.weight ? a.weight > b.weight : a.triangle < b.triangle;
  });
  std::string text;
  for (size_t i = 0; i < std::min(kMost, sums.size()); ++i) {
    text += (i > 0 ? "; " : "") + placeOf(scene_, sums[i].triangle);
    if (sums.size() > 1) text += " (" + std::to_string(std::lround(100 * sums[i].weight / all)) + " %)";
  }
  if (sums.size() > kMost) text += " and " + std::to_string(sums.size() - kMost) + " more";
  return text;
}

std::vector<bool> matching(const Scene& scene, const std::string& pattern) {
  const auto all = [&](const std::vector<std::string>& names) {
    std::vector<bool> out;
    for (const std::string& name : names) out.push_back(!name.empty() && fnmatch(pattern.c_str(), name.c_str(), 0) == 0);
    return out;
  };
  const std::vector<bool> nodes = all(scene.node_names), meshes = all(scene.mesh_names);
  std::vector<bool> materials;
  for (const Material& m : scene.materials) materials.push_back(fnmatch(pattern.c_str(), m.name.c_str(), 0) == 0);
  std::vector<bool> out(scene.triangles.size());
  size_t object = 0;
  for (size_t t = 0; t < out.size(); ++t) {
    while (object + 1 < scene.objects.size() && scene.objects[object + 1].first_triangle <= t) ++object;
    out[t] = materials[scene.triangles[t].material];
    if (scene.objects.empty() || scene.objects[object].first_triangle > t) continue;
    const auto [first, node, mesh] = scene.objects[object];
    out[t] = out[t] || (node < nodes.size() && nodes[node]) || (mesh < meshes.size() && meshes[mesh]);
  }
  return out;
}

}  // namespace ff::bake
