#include "bake/cleanup/coincident.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <tsl/robin_map.h>

#include "bake/rays/sobol.h"
#include "bake/rays/surface_sampling.h"

namespace ff::bake {
namespace {

constexpr double kRounding = 3e-6;  // of the largest coordinate: as far as rays start off a surface

// A triangle or a quad.
struct Face {
  std::array<Vec3, 4> corner;
  uint32_t corners;
  std::array<uint32_t, 2> triangles;  // of the scene; the second only of a quad
};

bool near(Vec3 a, Vec3 b, double tolerance) {
  for (int k = 0; k < 3; ++k)
    if (!(std::abs(static_cast<double>(a[k]) - static_cast<double>(b[k])) <= tolerance)) return false;
  return true;
}

bool isSame(const Face& a, const Face& b, bool any_side, double tolerance) {
  const uint32_t n = a.corners;
  for (uint32_t shift = 0; shift < n; ++shift)
    for (const bool reversed : {false, true}) {
      if (reversed && !any_side) continue;
      bool all = true;
      for (uint32_t i = 0; i < n && all; ++i)
        all = near(a.corner[i], b.corner[(reversed ? shift + n - i : shift + i) % n], tolerance);
      if (all) return true;
    }
  return false;
}

double brightness(const Material& m) {
  return 1e6 * static_cast<double>(m.emission.x + m.emission.y + m.emission.z) +
         static_cast<double>(m.base_color.x + m.base_color.y + m.base_color.z);
}

// Two triangles that have an edge in common and lie in one plane are a quad.
bool makeQuad(const Scene& scene, uint32_t t, uint32_t u, Face& quad) {
  const Triangle &a = scene.triangles[t], &b = scene.triangles[u];
  if (a.material != b.material) return false;
  const auto p = [&](const Triangle& of, size_t i) { return scene.positions[of.v[i % 3]]; };
  for (size_t i = 0; i < 3; ++i)
    for (size_t j = 0; j < 3; ++j) {
      if (!(p(a, i) == p(b, j + 1)) || !(p(a, i + 1) == p(b, j))) continue;
      const Vec3 n = cross(p(a, 1) - p(a, 0), p(a, 2) - p(a, 0)), off = p(b, j + 2) - p(a, 0);
      if (!(std::abs(dot(n, off)) <= 1e-4f * length(n) * length(off))) return false;
      quad = {{p(a, i), p(b, j + 2), p(a, i + 1), p(a, i + 2)}, 4, {t, u}};
      return true;
    }
  return false;
}

// t, u: one triangle's number twice, or those of a quad.
Face faceOf(const Scene& scene, uint32_t t, uint32_t u) {
  Face face;
  const auto& v = scene.triangles[t].v;
  if (t == u)
    face = {{scene.positions[v[0]], scene.positions[v[1]], scene.positions[v[2]], {}}, 3, {t, t}};
  else
    makeQuad(scene, t, u, face);
  return face;
}

// Faces by where they are; of those that coincide one stays.
class Finder {
 public:
  Finder(const Scene& scene, std::vector<bool>& duplicate) : scene_(scene), duplicate_(duplicate) {}

  void add(const Face& face) {
    double largest = 0;
    std::array<double, 3> centre{};
    for (uint32_t i = 0; i < face.corners; ++i)
      for (int k = 0; k < 3; ++k) {
        const auto x = static_cast<double>(face.corner[i][k]);
        largest = std::max(largest, std::abs(x));
        centre[static_cast<size_t>(k)] += x / face.corners;
      }
    const double tolerance = kRounding * largest;
    // Boxes some eight tolerances wide, and looked for in all that a tolerance reaches, of this size and, at its end, the next.
    std::array<int, 2> sizes{std::ilogb(largest * (1 - kRounding)), std::ilogb(largest * (1 + kRounding))};
    for (int s = 0; s < (sizes[0] == sizes[1] ? 1 : 2); ++s) {
      const double box = std::ldexp(1.0, sizes[static_cast<size_t>(s)] - 14);
      std::array<std::array<int64_t, 2>, 3> range;
      for (size_t k = 0; k < 3; ++k)
        range[k] = {std::llround(std::floor((centre[k] - tolerance) / box)), std::llround(std::floor((centre[k] + tolerance) / box))};
      for (int64_t x = range[0][0]; x <= range[0][1]; ++x)
        for (int64_t y = range[1][0]; y <= range[1][1]; ++y)
          for (int64_t z = range[2][0]; z <= range[2][1]; ++z) {
            const auto there = last_.find(key(x, y, z, sizes[static_cast<size_t>(s)], face.corners));
            for (uint32_t f = there == last_.end() ? kNone : there->second; f != kNone; f = before_[f])
              if (merge(faces_[f], face, tolerance)) return;
          }
    }
    const double box = std::ldexp(1.0, std::ilogb(largest) - 14);
    const auto at = [&](size_t k) { return std::llround(std::floor(centre[k] / box)); };
    const auto number = static_cast<uint32_t>(faces_.size());
    const auto [here, first] = last_.insert({key(at(0), at(1), at(2), std::ilogb(largest), face.corners), number});
    before_.push_back(first ? kNone : std::exchange(here.value(), number));
    faces_.push_back(face.triangles);
  }

 private:
  static uint64_t key(int64_t x, int64_t y, int64_t z, int size, uint32_t corners) {
    return mix64(mix64(mix64(static_cast<uint64_t>(x)) + static_cast<uint64_t>(y)) + static_cast<uint64_t>(z)) +
           static_cast<uint64_t>(size) * 8 + corners;
  }

  const Material& materialOf(const Face& face) const { return scene_.materials[scene_.triangles[face.triangles[0]].material]; }

  bool merge(std::array<uint32_t, 2>& there, const Face& face, double tolerance) {
    const Face kept = faceOf(scene_, there[0], there[1]);
    const Material &a = materialOf(kept), &b = materialOf(face);
    if ((a.cutout || b.cutout) && &a != &b) return false;
    if (a.double_sided != b.double_sided || !isSame(kept, face, a.double_sided, tolerance)) return false;
    const bool replace = brightness(b) > brightness(a);
    for (uint32_t i = 0; i + 2 < face.corners; ++i) duplicate_[(replace ? kept : face).triangles[i]] = true;
    if (replace) there = face.triangles;
    return true;
  }

  const Scene& scene_;
  std::vector<bool>& duplicate_;
  std::vector<std::array<uint32_t, 2>> faces_;
  tsl::robin_map<uint64_t, uint32_t> last_;  // of a box: its newest face
  std::vector<uint32_t> before_;             // of a face: the next older one of its box; kNone
};

}  // namespace

std::vector<bool> findDuplicates(const Scene& scene) {
  std::vector<bool> duplicate(scene.triangles.size());
  const auto n = static_cast<uint32_t>(scene.triangles.size());
  {
    Finder triangles(scene, duplicate);
    for (uint32_t t = 0; t < n; ++t) triangles.add(faceOf(scene, t, t));
  }
  Finder quads(scene, duplicate);
  Face quad;
  for (uint32_t t = 0; t + 1 < n; ++t) {
    if (duplicate[t] || duplicate[t + 1] || !makeQuad(scene, t, t + 1, quad)) continue;
    quads.add(quad);
    ++t;
  }
  return duplicate;
}

}  // namespace ff::bake
