#include "bake/cleanup/sky_dome.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <numbers>
#include <string>

#include "bake/cleanup/scene_names.h"
#include "formats/portable_math.h"

namespace ff::bake {
namespace {

// "sky", "SkyDome_01", "skybox.003", "low sky"; not "skylight", "skyscraper", "Husky".
bool isSkyName(const std::string& name) {
  std::string lower;
  for (size_t i = 0; i < name.size(); ++i) {
    const auto c = static_cast<unsigned char>(name[i]);
    if (i > 0 && std::isupper(c) && std::islower(static_cast<unsigned char>(name[i - 1]))) lower += ' ';
    lower += std::isalpha(c) ? static_cast<char>(std::tolower(c)) : ' ';
  }
  std::string word;
  for (const char c : lower + " ") {
    if (c != ' ') {
      word += c;
      continue;
    }
    for (const char* sky : {"sky", "skydome", "skybox", "skysphere", "skyball", "skymesh", "skyplane", "skies"})
      if (word == sky) return true;
    word.clear();
  }
  return false;
}

constexpr double kSphere = 4 * std::numbers::pi;

// Signed solid angle of a triangle, sr. A. Van Oosterom, J. Strackee. The solid angle of a plane triangle. 1983.
double solidAngle(Vec3 from, Vec3 p, Vec3 q, Vec3 r) {
  const Vec3 a = p - from, b = q - from, c = r - from;
  const auto la = static_cast<double>(length(a)), lb = static_cast<double>(length(b)), lc = static_cast<double>(length(c));
  const double volume = static_cast<double>(dot(a, cross(b, c)));
  const double below = la * lb * lc + static_cast<double>(dot(a, b)) * lc + static_cast<double>(dot(b, c)) * la + static_cast<double>(dot(c, a)) * lb;
  return 2 * arcTangent(volume, below);
}

// An edge's part in the integral of a triangle's directions, its upward component. James Arvo. Applications of irradiance tensors to the
// simulation of non-Lambertian phenomena. 1995.
double edgeUp(Vec3 a, Vec3 b) {
  const Vec3 n = cross(a, b);
  const auto sine = static_cast<double>(length(n));
  return sine > 0 ? 0.5 * arcTangent(sine, static_cast<double>(dot(a, b))) * static_cast<double>(n.y) / sine : 0;
}

constexpr double kSkySeen = 0.4;  // of the sphere around a place; half of it is a dome that ends at the ground
constexpr double kFrom = 0.9;    // of the places
constexpr size_t kPlaces = 128;  // looked from
constexpr double kBelow = 0.1;   // of the sphere: what fills more of it below than above is a ground
// As large as what it holds, or so many times as large where only its material tells: the walls of an unlit room hold its furniture, too.
constexpr float kNamedTimes = 1, kUnlitTimes = 2;

// Whether the chosen triangles enclose the corners of all others.
bool encloses(const Scene& scene, const std::vector<bool>& chosen, float times) {
  std::vector<uint32_t> dome, others;
  Box inner, outer;
  for (uint32_t t = 0; t < chosen.size(); ++t) {
    (chosen[t] ? dome : others).push_back(t);
    for (const uint32_t v : scene.triangles[t].v) (chosen[t] ? outer : inner).add(scene.positions[v]);
  }
  if (others.empty() || dome.empty() || !(length(outer.hi - outer.lo) >= times * length(inner.hi - inner.lo))) return false;
  size_t enclosed = 0;
  for (size_t i = 0; i < kPlaces; ++i) {
    const Vec3 from = scene.positions[scene.triangles[others[i * others.size() / kPlaces]].v[i % 3]];
    double angle = 0, up = 0;
    for (const uint32_t t : dome) {
      const auto& v = scene.triangles[t].v;
      angle += solidAngle(from, scene.positions[v[0]], scene.positions[v[1]], scene.positions[v[2]]);
      for (size_t k = 0; k < 3; ++k) up += edgeUp(normalized(scene.positions[v[k]] - from), normalized(scene.positions[v[(k + 1) % 3]] - from));
    }
    enclosed += std::abs(angle) >= kSkySeen * kSphere && std::copysign(up, up * angle) >= -kBelow * kSphere;
  }
  return static_cast<double>(enclosed) >= kFrom * static_cast<double>(kPlaces);
}

}  // namespace

std::vector<bool> findSkyDome(const Scene& scene) {
  const size_t n = scene.triangles.size();
  const auto named = [](const std::vector<std::string>& names) {
    std::vector<bool> out;
    for (const std::string& name : names) out.push_back(isSkyName(name));
    return out;
  };
  const std::vector<bool> nodes = named(scene.node_names), meshes = named(scene.mesh_names);
  std::vector<bool> by_name(n), dome;
  std::vector<Box> unlit(scene.materials.size());
  Box all;
  bool any = false;
  for (uint32_t t = 0; t < n; ++t) {
    const uint32_t m = scene.triangles[t].material;
    for (const uint32_t v : scene.triangles[t].v) {
      all.add(scene.positions[v]);
      if (scene.materials[m].unlit) unlit[m].add(scene.positions[v]);
    }
    const Object* object = objectOf(scene, t);
    by_name[t] = scene.materials[m].emission == Vec3{} &&
                 (isSkyName(scene.materials[m].name) || (object && object->node < nodes.size() && nodes[object->node]) ||
                  (object && object->mesh < meshes.size() && meshes[object->mesh]));
    any = any || by_name[t];
  }
  const auto take = [&](const std::vector<bool>& group, float times) {
    if (!encloses(scene, group, times)) return;
    dome.resize(n);
    for (size_t t = 0; t < n; ++t) dome[t] = dome[t] || group[t];
  };
  if (any) take(by_name, kNamedTimes);
  for (uint32_t m = 0; m < scene.materials.size(); ++m) {
    if (!(scene.materials[m].emission == Vec3{}) || unlit[m].empty() || length(unlit[m].hi - unlit[m].lo) < 0.5f * length(all.hi - all.lo)) continue;
    std::vector<bool> group(n);
    for (uint32_t t = 0; t < n; ++t) group[t] = scene.triangles[t].material == m;
    take(group, kUnlitTimes);
  }
  return dome;
}

}  // namespace ff::bake
