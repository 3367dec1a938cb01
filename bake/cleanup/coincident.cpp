#include "bake/cleanup/coincident.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <functional>
#include <span>
#include <utility>
#include <vector>

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

// The boxes in which faces are looked for that lie where one does: some eight tolerances wide, those that a tolerance reaches, of its size and, at its end,
// the next. A face is kept in `own`, which is one of them.
struct Boxes {
  explicit Boxes(const Face& face) {
    double largest = 0;
    std::array<double, 3> centre{};
    for (uint32_t i = 0; i < face.corners; ++i)
      for (int k = 0; k < 3; ++k) {
        const auto x = static_cast<double>(face.corner[i][k]);
        largest = std::max(largest, std::abs(x));
        centre[static_cast<size_t>(k)] += x / face.corners;
      }
    tolerance = kRounding * largest;
    const auto at = [&](double box, double off) {
      std::array<int64_t, 3> place;
      for (size_t k = 0; k < 3; ++k) place[k] = std::llround(std::floor((centre[k] + off) / box));
      return place;
    };
    const int own_size = std::ilogb(largest);
    const auto here = at(std::ldexp(1.0, own_size - 14), 0);
    own = keyOf(here[0], here[1], here[2], own_size, face.corners);
    const std::array<int, 2> sizes{std::ilogb(largest * (1 - kRounding)), std::ilogb(largest * (1 + kRounding))};
    for (size_t s = 0; s < (sizes[0] == sizes[1] ? 1u : 2u); ++s) {
      const double box = std::ldexp(1.0, sizes[s] - 14);
      const auto lo = at(box, -tolerance), hi = at(box, tolerance);
      for (int64_t x = lo[0]; x <= hi[0]; ++x)
        for (int64_t y = lo[1]; y <= hi[1]; ++y)
          for (int64_t z = lo[2]; z <= hi[2]; ++z)
            keys[count++] = keyOf(x, y, z, sizes[s], face.corners);
    }
  }

  double tolerance = 0;
  uint64_t own = 0;
  std::array<uint64_t, 16> keys{};
  size_t count = 0;
  std::span<const uint64_t> all() const { return std::span(keys).first(count); }

 private:
  static uint64_t keyOf(int64_t x, int64_t y, int64_t z, int size, uint32_t corners) {
    return mix64(mix64(mix64(static_cast<uint64_t>(x)) + static_cast<uint64_t>(y)) + static_cast<uint64_t>(z)) +
           static_cast<uint64_t>(size) * 8 + corners;
  }
};

// Which faces may lie where another does: that looks for them in the box that they are kept in, or the other way round. Of most scenes few, so that the
// others, as many as the scene has, need no table. Boxes are told by hashes of few bits, over and over, of the faces that are left; a few too many stay. On
// all of TBB's threads.
class Neighbours {
 public:
  static constexpr int kRounds = 4;
  // face_at(number, face): false where there is no such face. Thread-safe.
  template <class FaceAt>
  Neighbours(size_t faces, FaceAt face_at)
      : left_((faces + 63) / 64, ~uint64_t{0}), bits_(std::clamp(std::bit_ceil(8 * faces), kLeastBits, kMostBits)) {
    for (int round = 0; round < kRounds; ++round) {
      Bits kept(bits_, round), kept_again(bits_, round), wanted(bits_, round);
      each(face_at, [&](const Boxes& boxes) {
        if (kept.set(boxes.own)) kept_again.set(boxes.own);
        return true;
      });
      const auto finds = [&](const Boxes& boxes, uint64_t key) { return (key == boxes.own ? kept_again : kept).has(key); };
      each(face_at, [&](const Boxes& boxes) {
        for (const uint64_t key : boxes.all())
          if (finds(boxes, key)) wanted.set(key);
        return true;
      });
      each(face_at, [&](const Boxes& boxes) {
        return wanted.has(boxes.own) || std::ranges::any_of(boxes.all(), [&](uint64_t key) { return finds(boxes, key); });
      });
    }
  }
  bool has(size_t face) const { return left_[face / 64] >> (face & 63) & 1; }

 private:
  static constexpr size_t kLeastBits = size_t{1} << 12, kMostBits = size_t{1} << 27;

  // Keys, by some bits of a hash. Thread-safe.
  class Bits {
   public:
    Bits(size_t bits, int seed) : bits_(bits), seed_(static_cast<uint64_t>(seed)), word_(bits / 64) {}
    bool set(uint64_t key) {  // whether it was set
      const size_t p = place(key);
      const uint64_t bit = uint64_t{1} << (p & 63);
      return std::atomic_ref(word_[p / 64]).fetch_or(bit, std::memory_order_relaxed) & bit;
    }
    bool has(uint64_t key) const {
      const size_t p = place(key);
      return word_[p / 64] >> (p & 63) & 1;
    }

   private:
    size_t place(uint64_t key) const { return mix64(key + seed_) & (bits_ - 1); }
    const size_t bits_;
    const uint64_t seed_;
    std::vector<uint64_t> word_;
  };

  // keep(boxes) says which ones stay.
  template <class FaceAt, class Keep>
  void each(FaceAt face_at, Keep keep) {
    tbb::parallel_for(size_t{0}, left_.size(), [&](size_t word) {
      Face face{};
      for (uint64_t bits = left_[word]; bits; bits &= bits - 1) {
        const auto bit = static_cast<size_t>(std::countr_zero(bits));
        if (!face_at(64 * word + bit, face) || !keep(Boxes(face))) left_[word] &= ~(uint64_t{1} << bit);
      }
    });
  }

  std::vector<uint64_t> left_;  // a bit a face
  const size_t bits_;
};

// Faces by where they are; of those that coincide one stays.
class Finder {
 public:
  Finder(const Scene& scene, std::vector<bool>& duplicate) : scene_(scene), duplicate_(duplicate) {}

  void add(const Face& face) {
    const Boxes boxes(face);
    for (const uint64_t key : boxes.all()) {
      const auto there = last_.find(key);
      for (uint32_t f = there == last_.end() ? kNone : there->second; f != kNone; f = before_[f])
        if (merge(faces_[f], face, boxes.tolerance)) return;
    }
    const auto number = static_cast<uint32_t>(faces_.size());
    const auto [here, first] = last_.insert({boxes.own, number});
    before_.push_back(first ? kNone : std::exchange(here.value(), number));
    faces_.push_back(face.triangles);
  }

 private:
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
  PagedVector<std::array<uint32_t, 2>> faces_;
  tsl::robin_map<uint64_t, uint32_t, std::hash<uint64_t>, std::equal_to<uint64_t>, PagedAllocator<std::pair<uint64_t, uint32_t>>> last_;  // of a box: its newest face
  PagedVector<uint32_t> before_;             // of a face: the next older one of its box; kNone
};

}  // namespace

std::vector<bool> findDuplicates(const Scene& scene) {
  std::vector<bool> duplicate(scene.triangles.size());
  const auto n = static_cast<uint32_t>(scene.triangles.size());
  {
    const Neighbours neighbours(n, [&](size_t t, Face& face) {
      if (t < n) face = faceOf(scene, static_cast<uint32_t>(t), static_cast<uint32_t>(t));
      return t < n;
    });
    Finder triangles(scene, duplicate);
    for (uint32_t t = 0; t < n; ++t)
      if (neighbours.has(t)) triangles.add(faceOf(scene, t, t));
  }
  std::vector<bool> begins(n);  // a quad, with the next triangle
  Face quad;
  for (uint32_t t = 0; t + 1 < n; ++t)
    if (!duplicate[t] && !duplicate[t + 1] && makeQuad(scene, t, t + 1, quad)) begins[t++] = true;
  const Neighbours neighbours(n, [&](size_t t, Face& face) { return t < n && begins[t] && makeQuad(scene, static_cast<uint32_t>(t), static_cast<uint32_t>(t) + 1, face); });
  Finder quads(scene, duplicate);
  for (uint32_t t = 0; t + 1 < n; ++t)
    if (neighbours.has(t) && makeQuad(scene, t, t + 1, quad)) quads.add(quad);
  return duplicate;
}

}  // namespace ff::bake
