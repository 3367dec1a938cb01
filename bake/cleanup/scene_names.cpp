#include "bake/cleanup/scene_names.h"

#include <fnmatch.h>

#include <algorithm>

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

Vec3 middleOf(const Scene& scene, uint32_t triangle) {
  const auto& v = scene.triangles[triangle].v;
  return (scene.positions[v[0]] + scene.positions[v[1]] + scene.positions[v[2]]) / 3;
}

void PlaceSums::add(uint32_t triangle, double weight, Vec3 at) {
  const Object* object = objectOf(scene_, triangle);
  const std::pair key(object ? object->node : kNone, scene_.triangles[triangle].material);
  Sum& sum = sums_.try_emplace(key, Sum{triangle, {}}).first->second;
  sum.place.add(weight, at);
  sum.triangle = std::min(sum.triangle, triangle);
}

void PlaceSums::putInto(Finding& finding) const {
  std::vector<Sum> sums;
  double all = 0;
  for (const auto& [key, sum] : sums_) {
    sums.push_back(sum);
    all += sum.place.sum;
  }
  std::sort(sums.begin(), sums.end(), [](const Sum& a, const Sum& b) {
    return a.place.sum != b.place.sum ? a.place.sum > b.place.sum : a.triangle < b.triangle;
  });
  finding.more_places = sums.size() - std::min(sums.size(), kMaxPlaces);
  sums.resize(std::min(sums.size(), kMaxPlaces));
  for (const Sum& sum : sums) finding.places.push_back({inWorld(scene_, sum.place.at), placeOf(scene_, sum.triangle), all > 0 ? sum.place.sum / all : 1});
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
