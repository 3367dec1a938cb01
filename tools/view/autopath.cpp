// Camera paths for worlds that come without one: where people stand, looking at the most that there is to see.
//
// Standing places are floors with room for feet around them and for a head above them. From some hundred of them rays go
// all around; what they meet says how much of the scene is in view, how light it is, and in which direction a picture has
// the most in it.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>

#include "runtime/probes/box_tree.h"
#include "tools/view/camera.h"

namespace ff::view {
namespace {

constexpr double kSeconds = 6;
constexpr float kEyeHeight = 1.6f;        // m above the floor
constexpr float kRoomHeight = 2.2f;       // m; in a model lower than that, people are as tall as the third of it
constexpr size_t kCandidates = 400;       // places looked at closely
constexpr int kColumns = 64, kRows = 17;  // rays all around, of 80 degrees up and down
constexpr int kWindowColumns = 13, kWindowRows = 5;  // of them in a picture

float angleOf(int column) { return 6.2831853f * static_cast<float>(column) / kColumns; }
Vec3 directionOf(int column, int row) {
  const float up = 1.3962634f * (static_cast<float>(row) / (kRows / 2) - 1), flat = std::cos(up);
  return {flat * std::cos(angleOf(column)), std::sin(up), flat * std::sin(angleOf(column))};
}

// Patches in the void around a sealed world see the backs of its walls.
bool seesBacks(const formats::Node& n) { return n.absorbed > n.quanta / 10; }

struct Hit {
  float distance = std::numeric_limits<float>::infinity();
  bool front = false;
  uint32_t triangle = 0;
  bool any() const { return distance < std::numeric_limits<float>::infinity(); }
};

// First hits on the true triangles. Moeller, Trumbore. Fast, Minimum Storage Ray-Triangle Intersection. 1997.
class Walls {
 public:
  explicit Walls(const ViewScene& scene) : scene_(scene), tree_(boxes(scene), 4) {}

  Hit nearest(Vec3 from, Vec3 direction) const {
    const runtime::RayLine ray(from, direction);
    Hit hit;
    float limit = hit.distance;
    tree_.walk(ray, 1e-5f * scene_.cell_m, limit, [&](uint32_t first, uint32_t last) {
      for (uint32_t i = first; i < last; ++i) meet(ray, tree_.order()[i], hit);
      limit = hit.distance + sheet(hit.distance);
    });
    return hit;
  }

 private:
  static std::vector<Box> boxes(const ViewScene& scene) {
    std::vector<Box> boxes(scene.triangles());
    for (size_t t = 0; t < boxes.size(); ++t)
      for (size_t c = 0; c < 3; ++c) boxes[t].add(scene.corners[3 * t + c]);
    return boxes;
  }
  void meet(const runtime::RayLine& ray, uint32_t t, Hit& hit) const {
    const Vec3 a = scene_.corners[3 * t], ab = scene_.corners[3 * t + 1] - a, ac = scene_.corners[3 * t + 2] - a;
    const Vec3 p = cross(ray.direction, ac), to_a = ray.origin - a, q = cross(to_a, ab);
    const float det = dot(ab, p);
    if (det == 0) return;
    const float u = dot(to_a, p) / det, v = dot(ray.direction, q) / det, d = dot(ac, q) / det;
    if (u < 0 || v < 0 || u + v > 1 || d <= 0) return;
    const bool front = det > 0;
    const float head_start = front == hit.front ? 0 : front ? sheet(d) : -sheet(d);
    if (d - head_start < hit.distance) hit = {d, front, t};
  }
  // Of the two sides of one sheet, cut into triangles apart, the front is met.
  float sheet(float distance) const { return 1e-4f * (distance + scene_.cell_m); }

  const ViewScene& scene_;
  runtime::BoxTree tree_;
};

// Where somebody of this size can stand.
class Person {
 public:
  Person(const ViewScene& scene, const Walls& walls)
      : walls_(walls), eye_m_(kEyeHeight) {
    const float height = scene.bounds.hi.y - scene.bounds.lo.y;
    if (height < kRoomHeight && height > 0) eye_m_ = height / 3;
  }

  float eyeHeight() const { return eye_m_; }

  // The eye above a point of a floor; none: there is no room for feet or head.
  std::optional<Vec3> standOn(Vec3 floor) const {
    const float gap = 0.02f * eye_m_;
    const Hit above = walls_.nearest(floor + Vec3{0, gap, 0}, {0, 1, 0});
    if (above.any() && (!above.front || above.distance < 1.15f * eye_m_)) return std::nullopt;
    const Vec3 eye = floor + Vec3{0, eye_m_, 0};
    for (int i = 0; i < 16; ++i)  // elbows
      if (walls_.nearest(eye, {std::cos(angleOf(4 * i)), 0, std::sin(angleOf(4 * i))}).distance < 0.3f * eye_m_)
        return std::nullopt;
    // A table's top ends within the wider ring, a shelf's within the narrower one.
    if (firmAround(eye, 0.2f) < 8 || firmAround(eye, 0.6f) < 6) return std::nullopt;
    return eye;
  }

  // The eye a step farther, on whatever floor is there.
  std::optional<Vec3> stepTo(Vec3 eye) const {
    const Hit floor = walls_.nearest(eye, {0, -1, 0});
    if (!isFloor(floor)) return std::nullopt;
    return standOn(eye - Vec3{0, floor.distance, 0});
  }

 private:
  bool isFloor(const Hit& below) const { return below.front && std::abs(below.distance - eye_m_) < 0.25f * eye_m_; }
  int firmAround(Vec3 eye, float radius) const {
    int firm = 0;
    for (int i = 0; i < 8; ++i) {
      const float r = radius * eye_m_, angle = angleOf(kColumns / 8 * i);
      firm += isFloor(walls_.nearest(eye + Vec3{r * std::cos(angle), 0, r * std::sin(angle)}, {0, -1, 0}));
    }
    return firm;
  }

  const Walls& walls_;
  float eye_m_;
};

// How many triangles there are around: in cubes.
class Detail {
 public:
  using Cube = std::array<int32_t, 3>;
  Detail(const ViewScene& scene, float size_m) : origin_(scene.bounds.lo), size_m_(size_m) {
    for (size_t t = 0; t < scene.triangles(); ++t) ++triangles_[cubeOf(scene.corners[3 * t])];
  }
  Cube cubeOf(Vec3 p) const {
    Cube c;
    for (int a = 0; a < 3; ++a) c[static_cast<size_t>(a)] = static_cast<int32_t>(std::floor((p[a] - origin_[a]) / size_m_));
    return c;
  }
  uint32_t in(const Cube& cube) const {
    const auto found = triangles_.find(cube);
    return found != triangles_.end() ? found->second : 0;
  }
  // In the cube and its neighbours.
  uint32_t around(Vec3 p) const {
    const Cube c = cubeOf(p);
    uint32_t sum = 0;
    for (int i = 0; i < 27; ++i) sum += in({c[0] + i % 3 - 1, c[1] + i / 3 % 3 - 1, c[2] + i / 9 - 1});
    return sum;
  }

 private:
  Vec3 origin_;
  float size_m_;
  std::map<Cube, uint32_t> triangles_;
};

// Floors to try: as many from where the scene has much detail as its triangles tell (a room on a wide empty ground).
std::vector<uint32_t> floorsToTry(const ViewScene& scene, const Detail& detail) {
  std::map<Detail::Cube, uint32_t> floors;
  std::vector<uint32_t> candidates;
  for (uint32_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    if (n.normal.y < 0.7f || seesBacks(n)) continue;
    candidates.push_back(p);
    ++floors[detail.cubeOf(n.centroid)];
  }
  // A cube's share is the root of its triangles, divided among its floors.
  std::vector<double> until;
  double sum = 0;
  for (const uint32_t p : candidates) {
    const Detail::Cube cube = detail.cubeOf(scene.patches[p].centroid);
    sum += std::sqrt(1.0 + detail.in(cube)) / floors[cube];
    until.push_back(sum);
  }
  std::vector<uint32_t> chosen;
  constexpr size_t kTried = 4 * kCandidates;  // most have no room
  for (size_t i = 0, at = 0; i < kTried && at < candidates.size(); ++i) {
    while (at < candidates.size() && until[at] * kTried < sum * (static_cast<double>(i) + 0.5)) ++at;
    if (at < candidates.size() && (chosen.empty() || chosen.back() != candidates[at])) chosen.push_back(candidates[at]);
  }
  return chosen;
}

// What is seen around an eye.
struct Panorama {
  Vec3 eye;
  std::vector<Hit> hits = std::vector<Hit>(size_t{kColumns} * kRows);  // by column, then row
  double light = 0;    // that arrives there, roughly: what emits, what sees the sky; by night what lamps light
  double patches = 0;  // different ones in view
  double detail = 0;   // triangles around
  double backs = 0;    // of the rays

  const Hit& at(int column, int row) const {
    return hits[static_cast<size_t>((column + kColumns) % kColumns * kRows + row)];
  }
};

// What the surface that a ray meets reflects of the lamps' light, W/m2.
double lampLight(const ViewScene& scene, const Hit& hit) {
  if (!hit.any()) return 0;
  const uint32_t patch = scene.triangle_patch[hit.triangle];
  const Vec3 reflected = scene.patches[patch].albedo * scene.lamps[patch];
  return static_cast<double>(std::max({reflected.x, reflected.y, reflected.z}));
}

Panorama lookAround(const ViewScene& scene, const Walls& walls, Vec3 eye, bool by_night) {
  Panorama p;
  p.eye = eye;
  std::vector<uint32_t> seen;
  double weight = 0;
  for (int c = 0; c < kColumns; ++c)
    for (int r = 0; r < kRows; ++r) {
      const Vec3 direction = directionOf(c, r);
      const Hit hit = walls.nearest(eye, direction);
      p.hits[static_cast<size_t>(c * kRows + r)] = hit;
      const double solid = std::sqrt(std::max(0.0f, 1 - direction.y * direction.y));
      weight += solid;
      if (!hit.any()) {
        p.light += by_night ? 0 : 3 * solid;  // the sky
        continue;
      }
      p.backs += hit.front ? 0 : solid;
      const uint32_t patch = scene.triangle_patch[hit.triangle];
      seen.push_back(patch);
      const formats::Node& n = scene.patches[patch];
      if (by_night) {
        p.light += solid * lampLight(scene, hit);
        continue;
      }
      const Vec3 emitted = n.emission;
      const double open = static_cast<double>(n.sky_fraction);
      p.light += solid * (static_cast<double>(std::max({emitted.x, emitted.y, emitted.z})) + 3 * open);
    }
  std::sort(seen.begin(), seen.end());
  p.patches = static_cast<double>(std::unique(seen.begin(), seen.end()) - seen.begin());
  p.light /= weight;
  p.backs /= weight;
  return p;
}

// How much a picture in this direction shows: edges between neighbouring rays, and depth.
double pictureScore(const ViewScene& scene, const Panorama& p, int column, float eye_m) {
  const auto normalAt = [&](const Hit& h) {
    const size_t t = size_t{3} * h.triangle;
    return normalized(cross(scene.corners[t + 1] - scene.corners[t], scene.corners[t + 2] - scene.corners[t]));
  };
  const auto albedoAt = [&](const Hit& h) { return scene.patches[scene.triangle_patch[h.triangle]].albedo; };
  const auto edge = [&](const Hit& a, const Hit& b) {
    if (!a.any() || !b.any()) return a.any() != b.any();
    const float farther = std::max(a.distance, b.distance), nearer = std::min(a.distance, b.distance);
    return farther > 1.3f * nearer || std::abs(dot(normalAt(a), normalAt(b))) < 0.8f ||
           length(albedoAt(a) - albedoAt(b)) > 0.15f;
  };
  int edges = 0, pairs = 0, missed = 0, close = 0, rays = 0;
  double depth = 0;
  for (int c = column - kWindowColumns / 2; c <= column + kWindowColumns / 2; ++c)
    for (int r = kRows / 2 - kWindowRows / 2; r <= kRows / 2 + kWindowRows / 2; ++r) {
      const Hit& h = p.at(c, r);
      ++rays;
      missed += !h.any();
      close += h.distance < 0.8f * eye_m;
      if (h.any()) depth += std::log1p(static_cast<double>(h.distance / eye_m));
      if (c < column + kWindowColumns / 2) ++pairs, edges += edge(h, p.at(c + 1, r));
      if (r < kRows / 2 + kWindowRows / 2) ++pairs, edges += edge(h, p.at(c, r + 1));
    }
  if (2 * missed > rays || 6 * close > rays) return 0;
  const double structure = static_cast<double>(edges) / pairs;
  depth /= std::max(1, rays - missed);
  return (0.1 + structure) * std::min(depth, 3.0);
}

// Share of a picture's rays that meet surface that is lit at least so much.
double litShare(const ViewScene& scene, const Panorama& p, int column, double least) {
  int lit = 0;
  for (int c = column - kWindowColumns / 2; c <= column + kWindowColumns / 2; ++c)
    for (int r = kRows / 2 - kWindowRows / 2; r <= kRows / 2 + kWindowRows / 2; ++r)
      lit += lampLight(scene, p.at(c, r)) > least;
  return static_cast<double>(lit) / (kWindowColumns * kWindowRows);
}

// A few steps ahead, as far as the floor allows.
CameraPath walk(const Person& person, Vec3 eye, Vec3 direction, float reach) {
  const float most = std::min(0.3f * reach, 2.5f * person.eyeHeight()), step = 0.25f * person.eyeHeight();
  Vec3 end = eye;
  for (float along = step; along < most; along += step) {
    const auto next = person.stepTo(end + direction * step);
    if (!next) break;
    end = *next;
  }
  const float ahead = std::min(reach, 40 * person.eyeHeight());
  const Vec3 look = direction * ahead - Vec3{0, 0.08f * ahead, 0};
  return {.fps = 30, .keys = {{0, eye, eye + look}, {kSeconds, end, end + look}}, .sun = {}, .sky = {}};
}

// Where nobody can stand: from a corner above, at all there is.
CameraPath overAll(const ViewScene& scene) {
  const Vec3 size = scene.bounds.hi - scene.bounds.lo, centre = (scene.bounds.lo + scene.bounds.hi) * 0.5f;
  const float away = 0.9f * length(size);
  CameraPath path;
  for (const double t : {0.0, kSeconds}) {
    const float angle = 0.7f + 0.3f * static_cast<float>(t / kSeconds);
    path.keys.push_back({t, centre + Vec3{away * std::cos(angle), 0.5f * away, away * std::sin(angle)}, centre});
  }
  return path;
}

}  // namespace

float openness(const ViewScene& scene) {
  double sky = 0, area = 0;
  for (const formats::Node& n : scene.patches) {
    if (n.quanta == 0 || seesBacks(n)) continue;
    sky += static_cast<double>(n.area_m2) * static_cast<double>(n.sky_fraction);
    area += static_cast<double>(n.area_m2);
  }
  return area > 0 ? static_cast<float>(sky / area) : 0.0f;
}

CameraPath findPath(const ViewScene& scene, bool by_night) {
  const Walls walls(scene);
  const Person person(scene, walls);
  const Detail detail(scene, 2 * person.eyeHeight());
  std::vector<Panorama> places;
  for (const uint32_t floor : floorsToTry(scene, detail)) {
    const auto eye = person.standOn(scene.patches[floor].centroid);
    if (!eye) continue;
    Panorama around = lookAround(scene, walls, *eye, by_night);
    around.detail = detail.around(*eye);
    if (around.backs < 0.03) places.push_back(std::move(around));
  }
  double max_patches = 0, max_detail = 0;
  std::vector<double> lights;
  for (const Panorama& p : places) {
    max_patches = std::max(max_patches, p.patches);
    max_detail = std::max(max_detail, p.detail);
    lights.push_back(p.light);
  }
  if (!lights.empty()) std::nth_element(lights.begin(), lights.begin() + static_cast<std::ptrdiff_t>(lights.size() / 2), lights.end());
  // By night most places are dark: the mean is that of those that are not.
  const double middle = lights.empty() ? 0 : by_night ? std::accumulate(lights.begin(), lights.end(), 0.0) / static_cast<double>(lights.size()) : lights[lights.size() / 2];
  const double usual_light = std::max(middle, 1e-9);
  double best = 0;
  const Panorama* where = nullptr;
  int column = 0;
  for (const Panorama& p : places) {
    const double place = p.patches / max_patches * std::sqrt(p.detail / max_detail) * (0.05 + p.light / (p.light + usual_light));
    for (int c = 0; c < kColumns; ++c) {
      const double score = place * pictureScore(scene, p, c, person.eyeHeight()) * (by_night ? 0.05 + litShare(scene, p, c, usual_light / 20) : 1);
      if (score <= best) continue;
      best = score;
      where = &p;
      column = c;
    }
  }
  if (!where) return overAll(scene);
  const Hit& ahead = where->at(column, kRows / 2);
  const float reach = ahead.any() ? ahead.distance : 40 * person.eyeHeight();
  return walk(person, where->eye, directionOf(column, kRows / 2), reach);
}

}  // namespace ff::view
