// Camera paths for worlds that come without one.
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "tools/view_camera.h"

namespace ff::view {
namespace {

constexpr float kInteriorOpenness = 0.25f;
constexpr float kInteriorPlan = 0.6f;
constexpr float kUnderRoof = 0.15f;  // of a floor's hemisphere is sky, at most
constexpr size_t kCandidates = 600;
constexpr size_t kLookedAt = 200;  // best candidates by voxels that are looked at closely,
constexpr int kConfirmed = 12;     // until so many are good
constexpr int kRing = 32;  // horizontal directions looked at
constexpr double kSeconds = 6;

// Which voxels hold surface; half a grid cell wide, coarser for very large worlds.
class Occupancy {
 public:
  explicit Occupancy(const ViewScene& scene) {
    const Vec3 size = scene.bounds.hi - scene.bounds.lo;
    step_ = std::max(0.5f * scene.cell_m, std::max({size.x, size.y, size.z}) / 300);
    origin_ = scene.bounds.lo - Vec3{step_, step_, step_};
    for (int a = 0; a < 3; ++a) n_[a] = static_cast<int>(size[a] / step_) + 3;
    voxels_.resize(static_cast<size_t>(n_[0]) * static_cast<size_t>(n_[1]) * static_cast<size_t>(n_[2]));
    for (size_t t = 0; t < scene.triangles(); ++t) {
      const Vec3 &a = scene.corners[3 * t], &b = scene.corners[3 * t + 1], &c = scene.corners[3 * t + 2];
      const Vec3 normal = normalized(cross(b - a, c - a));
      const float longest = std::max({length(b - a), length(c - b), length(a - c)});
      const float spacing = std::max(0.5f * step_ / std::max(longest, 1e-6f), 1.0f / 64);
      for (float u = 0; u < 1 + spacing; u += spacing)
        for (float v = 0; v < 1 + spacing - u; v += spacing)
          if (const auto at = index(a + (b - a) * std::min(u, 1.0f) + (c - a) * std::min(v, 1 - std::min(u, 1.0f))))
            voxels_[*at].add(normal);
    }
  }

  float step() const { return step_; }

  // Free distance along a unit direction; negative infinity where the ray leaves the world unhindered or meets the back
  // of a surface, which is to say that it began outside.
  float free(Vec3 from, Vec3 direction, float most) const {
    for (float d = 0; d < most; d += 0.5f * step_) {
      const auto at = index(from + direction * d);
      if (!at) return -std::numeric_limits<float>::infinity();
      const Voxel& v = voxels_[*at];
      if (v.full) return v.showsBackTo(direction) ? -std::numeric_limits<float>::infinity() : d;
    }
    return most;
  }

  // Height of the highest surface above a point of the plan, the world's floor where there is none.
  float top(float x, float z) const {
    for (int y = n_[1] - 1; y >= 0; --y) {
      const float height = origin_.y + (static_cast<float>(y) + 0.5f) * step_;
      const auto at = index({x, height, z});
      if (at && voxels_[*at].full) return height + 0.5f * step_;
    }
    return origin_.y;
  }

 private:
  struct Voxel {
    bool full = false;
    int8_t normal[3] = {};  // sum of the faces' normals, saturating

    void add(Vec3 n) {
      full = true;
      for (int a = 0; a < 3; ++a)
        normal[a] = static_cast<int8_t>(std::clamp(static_cast<float>(normal[a]) + 8 * n[a], -127.0f, 127.0f));
    }
    bool showsBackTo(Vec3 direction) const {
      const Vec3 n{static_cast<float>(normal[0]), static_cast<float>(normal[1]), static_cast<float>(normal[2])};
      return dot(normalized(n), direction) > 0.3f;  // not where several faces meet edgewise or back to back
    }
  };

  std::optional<size_t> index(Vec3 p) const {
    size_t at = 0;
    for (int a = 2; a >= 0; --a) {
      const int i = static_cast<int>(std::floor((p[a] - origin_[a]) / step_));
      if (i < 0 || i >= n_[a]) return std::nullopt;
      at = at * static_cast<size_t>(n_[a]) + static_cast<size_t>(i);
    }
    return at;
  }
  Vec3 origin_;
  float step_ = 1;
  int n_[3] = {};
  std::vector<Voxel> voxels_;
};

struct Shot {
  Vec3 eye, direction;
  float reach = 0, score = -1;
  bool sky = false;  // the floor sees some
};

// From above a floor patch: the horizontal direction with the deepest view that ends on a surface, and room to walk.
Shot bestShot(const Occupancy& space, Vec3 floor, float cell, float extent) {
  Shot best;
  const Vec3 above = floor + Vec3{0, 1.5f * space.step(), 0};
  const float room = space.free(above, {0, 1, 0}, 16 * cell);
  if (std::isinf(room)) return best;  // no roof
  const float height = room + 1.5f * space.step();
  if (height < 4 * space.step()) return best;
  best.eye = floor + Vec3{0, std::min(0.55f * height, 7 * cell), 0};
  float distance[kRing];
  for (int i = 0; i < kRing; ++i) {
    const float angle = 6.2831853f * static_cast<float>(i) / kRing;
    distance[i] = space.free(best.eye, {std::cos(angle), 0, std::sin(angle)}, extent);
  }
  const float elbow = std::abs(*std::min_element(distance, distance + kRing, [](float a, float b) { return std::abs(a) < std::abs(b); }));
  const auto out = std::count_if(distance, distance + kRing, [](float d) { return std::isinf(d); });
  if (elbow < cell || out > kRing / 4) return best;
  for (int i = 0; i < kRing; ++i) {
    float wide = 0;  // over about 60 degrees
    float nearest = extent;
    int lost = 0;
    for (int k = -3; k <= 3; ++k) {
      const float d = distance[(i + k + kRing) % kRing];
      if (std::isinf(d)) {
        ++lost;
        continue;
      }
      wide += d / 7;
      nearest = std::min(nearest, d);
    }
    if (std::isinf(distance[i]) || lost > 2) continue;
    const float score = std::sqrt(distance[i] * wide) + 2 * std::min(nearest, 4 * cell) + std::min(elbow, 3 * cell);
    if (score <= best.score) continue;
    const float angle = 6.2831853f * static_cast<float>(i) / kRing;
    best.direction = {std::cos(angle), 0, std::sin(angle)};
    best.reach = distance[i];
    best.score = score;
  }
  return best;
}

// Patches in the void around a sealed world see the backs of its walls.
bool seesBacks(const formats::Node& n) { return n.absorbed > n.quanta / 10; }

bool isFloorUnderRoof(const formats::Node& n) {
  return n.normal.y > 0.8f && static_cast<float>(n.sky) < kUnderRoof * static_cast<float>(n.quanta) && !seesBacks(n);
}

// The share of the world's plan with a floor under a roof: near 1 for one building, less for a town or a landscape with
// caves. (A building's outer walls see the sky, so openness alone does not tell.)
float coveredPlan(const ViewScene& scene) {
  const Vec3 size = scene.bounds.hi - scene.bounds.lo;
  const float step = std::max(scene.cell_m, std::max(size.x, size.z) / 512);
  const auto columns = static_cast<size_t>(size.x / step) + 1, rows = static_cast<size_t>(size.z / step) + 1;
  std::vector<uint8_t> kind(columns * rows, 0);
  for (const formats::Node& n : scene.patches) {
    const auto x = static_cast<size_t>(std::max(0.0f, n.centroid.x - scene.bounds.lo.x) / step);
    const auto z = static_cast<size_t>(std::max(0.0f, n.centroid.z - scene.bounds.lo.z) / step);
    uint8_t& k = kind[std::min(x, columns - 1) + columns * std::min(z, rows - 1)];
    k = std::max<uint8_t>(k, isFloorUnderRoof(n) ? 2 : 1);
  }
  const auto covered = std::count(kind.begin(), kind.end(), 2), used = covered + std::count(kind.begin(), kind.end(), 1);
  return used > 0 ? static_cast<float>(covered) / static_cast<float>(used) : 0.0f;
}

struct Hit {
  float distance = std::numeric_limits<float>::infinity();
  bool front = false;
};

// First hits of rays from one point, on the true triangles. Moeller, Trumbore. Fast, Minimum Storage Ray-Triangle
// Intersection. 1997.
std::vector<Hit> cast(const ViewScene& scene, Vec3 from, std::span<const Vec3> directions) {
  std::vector<Hit> hits(directions.size());
  for (size_t t = 0; t < scene.triangles(); ++t) {
    const Vec3 a = scene.corners[3 * t], ab = scene.corners[3 * t + 1] - a, ac = scene.corners[3 * t + 2] - a;
    const Vec3 n = cross(ab, ac), to_a = from - a, q = cross(to_a, ab);
    for (size_t i = 0; i < directions.size(); ++i) {
      const Vec3 p = cross(directions[i], ac);
      const float det = dot(ab, p);
      if (det == 0) continue;
      const float u = dot(to_a, p) / det, v = dot(directions[i], q) / det, d = dot(ac, q) / det;
      if (u < 0 || v < 0 || u + v > 1 || d <= 0 || d > hits[i].distance) continue;
      const bool front = dot(n, directions[i]) < 0;
      if (d == hits[i].distance && !front) continue;  // two sides of one sheet
      hits[i] = {d, front};
    }
  }
  return hits;
}

// The patches that shine most at a point, whether it sees them or not.
std::vector<Vec3> brightest(const ViewScene& scene, Vec3 at) {
  std::vector<std::pair<float, Vec3>> lamps;
  for (const formats::Node& n : scene.patches) {
    const float power = (n.emission.x + n.emission.y + n.emission.z) * n.area_m2;
    if (power > 0) lamps.emplace_back(power / std::max(dot(n.centroid - at, n.centroid - at), 1e-6f), n.centroid);
  }
  const size_t count = std::min<size_t>(lamps.size(), 8);
  std::partial_sort(lamps.begin(), lamps.begin() + static_cast<std::ptrdiff_t>(count), lamps.end(),
                    [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<Vec3> places;
  for (size_t i = 0; i < count; ++i) places.push_back(lamps[i].second);
  return places;
}

// Voxels are coarse: sees to it that the eye is in free space surrounded by fronts of surfaces, and sets the true reach
// and a score that prefers places that light comes to.
bool confirmed(const ViewScene& scene, Shot& shot) {
  std::vector<Vec3> around{shot.direction, {0, 1, 0}, {0, -1, 0}};
  for (int i = 0; i < 12; ++i) {
    const float angle = 0.1f + 6.2831853f * static_cast<float>(i) / 12;
    around.push_back(normalized({std::cos(angle), i % 3 == 0 ? 0.5f : i % 3 == 1 ? -0.3f : 0.0f, std::sin(angle)}));
  }
  const size_t directions = around.size();
  const std::vector<Vec3> lamps = brightest(scene, shot.eye);
  for (const Vec3 lamp : lamps) around.push_back(normalized(lamp - shot.eye));
  const std::vector<Hit> hits = cast(scene, shot.eye, around);
  size_t fronts = 0, backs = 0;
  for (size_t i = 0; i < directions; ++i) {
    fronts += hits[i].front;
    backs += !hits[i].front && !std::isinf(hits[i].distance);
    if (hits[i].distance < 0.5f * scene.cell_m) return false;
  }
  shot.reach = hits[0].distance;
  bool lit = shot.sky;
  for (size_t i = 0; i < lamps.size(); ++i)
    lit |= hits[directions + i].distance > 0.98f * length(lamps[i] - shot.eye) - 0.1f * scene.cell_m;
  shot.score = shot.reach * (lit ? 1.0f : 0.1f);
  return hits[0].front && fronts >= 10 && backs <= 2 && shot.reach > 3 * scene.cell_m;
}

CameraPath overTheMiddle(const ViewScene& scene, const Occupancy& space) {
  const Vec3 size = scene.bounds.hi - scene.bounds.lo;
  Vec3 centre = (scene.bounds.lo + scene.bounds.hi) * 0.5f;
  centre.y = space.top(centre.x, centre.z);
  const float radius = 0.3f * std::min(size.x, size.z);
  constexpr int kKeys = 25;
  float height = centre.y;
  std::vector<Vec3> ring;
  for (int i = 0; i < kKeys; ++i) {
    const float angle = 0.6f + 1.6f * static_cast<float>(i) / (kKeys - 1);
    ring.push_back({centre.x + radius * std::cos(angle), 0, centre.z + radius * std::sin(angle)});
    height = std::max(height, space.top(ring.back().x, ring.back().z));
  }
  CameraPath path;
  for (int i = 0; i < kKeys; ++i) {
    Vec3 eye = ring[static_cast<size_t>(i)];
    eye.y = height + std::max(3 * scene.cell_m, 0.15f * radius);
    path.keys.push_back({kSeconds * i / (kKeys - 1), eye, {centre.x, centre.y - 0.1f * radius, centre.z}});
  }
  return path;
}

}  // namespace

float openness(const ViewScene& scene) {
  double sky = 0, area = 0;
  for (const formats::Node& n : scene.patches) {
    if (n.quanta == 0 || seesBacks(n)) continue;
    sky += static_cast<double>(n.area_m2) * n.sky / n.quanta;
    area += static_cast<double>(n.area_m2);
  }
  return area > 0 ? static_cast<float>(sky / area) : 0.0f;
}

CameraPath findPath(const ViewScene& scene) {
  const Occupancy space(scene);
  if (openness(scene) > kInteriorOpenness && coveredPlan(scene) < kInteriorPlan) return overTheMiddle(scene, space);
  std::vector<const formats::Node*> floors;
  for (const formats::Node& n : scene.patches)
    if (isFloorUnderRoof(n)) floors.push_back(&n);
  const Vec3 size = scene.bounds.hi - scene.bounds.lo;
  const float extent = std::min(length(size), 60 * scene.cell_m);
  std::vector<Shot> shots;
  const size_t stride = std::max<size_t>(1, floors.size() / kCandidates);
  for (size_t i = 0; i < floors.size(); i += stride) {
    Shot shot = bestShot(space, floors[i]->centroid, scene.cell_m, extent);
    shot.sky = floors[i]->sky > floors[i]->quanta / 100;
    if (shot.score > 0) shots.push_back(shot);
  }
  std::stable_sort(shots.begin(), shots.end(), [](const Shot& a, const Shot& b) { return a.score > b.score; });
  Shot best;
  best.score = 0;
  int confirmations = 0;
  for (size_t i = 0; i < std::min(shots.size(), kLookedAt) && confirmations < kConfirmed; ++i) {
    if (!confirmed(scene, shots[i])) continue;
    ++confirmations;
    if (shots[i].score > best.score) best = shots[i];
  }
  if (confirmations == 0) return overTheMiddle(scene, space);
  CameraPath path;
  const Vec3 step = best.direction * (0.3f * best.reach);
  const Vec3 target = best.eye + best.direction * best.reach - Vec3{0, 0.08f * best.reach, 0};
  path.keys = {{0, best.eye, target}, {kSeconds, best.eye + step, target + step * 0.5f}};
  return path;
}

}  // namespace ff::view
