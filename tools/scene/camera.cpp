#include "tools/scene/camera.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <nlohmann/json.hpp>
#include <optional>

#include "formats/portable_math.h"

namespace ff::tools {
namespace {

constexpr float kClearance = 0.2f;
constexpr float kStep = 0.25f;  // between keys, voxels
constexpr float kHalfTurn = 3.14159265f;  // rad

Int3 voxelOf(Vec3 p) {
  return {static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)), static_cast<int>(std::floor(p.z))};
}
Vec3 middle(Int3 p) {
  return {static_cast<float>(p.x) + 0.5f, static_cast<float>(p.y) + 0.5f, static_cast<float>(p.z) + 0.5f};
}

// In voxel coordinates, as all of this file up to flyThrough.
bool clear(const Voxels& v, Vec3 p, float r) {
  for (int corner = 0; corner < 8; ++corner) {
    const Vec3 q = p + Vec3{corner & 1 ? r : -r, corner & 2 ? r : -r, corner & 4 ? r : -r};
    if (!v.air(voxelOf(q))) return false;
  }
  return true;
}

bool clearLine(const Voxels& v, Vec3 a, Vec3 b) {
  const int steps = 1 + static_cast<int>(length(b - a) * 10);
  for (int i = 0; i <= steps; ++i)
    if (!clear(v, a + (b - a) * (static_cast<float>(i) / static_cast<float>(steps)), 0.3f)) return false;
  return true;
}

// Shortest way from voxel to voxel through air (breadth first, six neighbours), inside a window around both ends.
std::optional<std::vector<Vec3>> walk(const Voxels& v, Int3 from, Int3 to) {
  constexpr int kReach = 40;
  const Int3 lo{std::max(0, std::min(from.x, to.x) - kReach), 0, std::max(0, std::min(from.z, to.z) - kReach)};
  const Int3 hi{std::min(v.size().x - 1, std::max(from.x, to.x) + kReach), v.size().y - 1,
                std::min(v.size().z - 1, std::max(from.z, to.z) + kReach)};
  const Int3 n{hi.x - lo.x + 1, hi.y - lo.y + 1, hi.z - lo.z + 1};
  const auto index = [&](Int3 p) {
    return (static_cast<size_t>(p.y - lo.y) * static_cast<size_t>(n.z) + static_cast<size_t>(p.z - lo.z)) *
               static_cast<size_t>(n.x) + static_cast<size_t>(p.x - lo.x);
  };
  if (!v.air(from) || !v.air(to)) return std::nullopt;
  std::vector<int8_t> came(static_cast<size_t>(n.x) * static_cast<size_t>(n.y) * static_cast<size_t>(n.z), -1);
  std::deque<Int3> queue{to};
  came[index(to)] = 6;
  while (!queue.empty() && came[index(from)] < 0) {
    const Int3 p = queue.front();
    queue.pop_front();
    for (size_t d = 0; d < 6; ++d) {
      const Int3 q = p + kFaceNormals[d];
      if (q.x < lo.x || q.y < lo.y || q.z < lo.z || q.x > hi.x || q.y > hi.y || q.z > hi.z) continue;
      if (came[index(q)] >= 0 || !v.air(q)) continue;
      came[index(q)] = static_cast<int8_t>(d ^ 1);  // the way back to p
      queue.push_back(q);
    }
  }
  if (came[index(from)] < 0) return std::nullopt;
  std::vector<Vec3> path{middle(from)};
  for (Int3 p = from; !(p == to);) {
    p = p + kFaceNormals[static_cast<size_t>(came[index(p)])];
    path.push_back(middle(p));
  }
  return path;
}

// Straight where the line is free, then evenly spaced, then relaxed towards a smooth curve; every point stays in air.
std::vector<Vec3> smoothed(const Voxels& v, const std::vector<Vec3>& path) {
  std::vector<Vec3> corners{path.front()};
  for (size_t i = 0; i + 1 < path.size();) {
    size_t j = std::min(i + 60, path.size() - 1);
    while (j > i + 1 && !clearLine(v, path[i], path[j])) --j;
    corners.push_back(path[j]);
    i = j;
  }
  std::vector<Vec3> p;
  for (size_t i = 0; i + 1 < corners.size(); ++i) {
    const Vec3 d = corners[i + 1] - corners[i];
    const int steps = std::max(1, static_cast<int>(length(d) / kStep));
    for (int s = 0; s < steps; ++s) p.push_back(corners[i] + d * (static_cast<float>(s) / static_cast<float>(steps)));
  }
  p.push_back(corners.back());
  for (int round = 0; round < 60; ++round)
    for (size_t i = 1; i + 1 < p.size(); ++i) {
      const Vec3 q = (p[i - 1] + p[i + 1]) * 0.5f;
      if (clear(v, q, 0.3f)) p[i] = q;
    }
  return p;
}

Vec3 direction(float yaw, float pitch) {
  const SineCosine y = sineCosine(static_cast<double>(yaw)), p = sineCosine(static_cast<double>(pitch));
  return {static_cast<float>(y.cosine * p.cosine), static_cast<float>(p.sine), static_cast<float>(y.sine * p.cosine)};
}

float angleOf(float y, float x) { return static_cast<float>(arcTangent(static_cast<double>(y), static_cast<double>(x))); }

struct Shot {
  Vec3 eye, look;
  float speed;  // voxels/s
};

// Along `path`, looking `ahead` voxels forward; the last stretch keeps its direction.
void follow(std::vector<Shot>& shots, const std::vector<Vec3>& path, float speed) {
  constexpr size_t kAhead = 14;
  Vec3 look{1, 0, 0};
  for (size_t i = 0; i < path.size(); ++i) {
    const Vec3 d = path[std::min(i + kAhead, path.size() - 1)] - path[i];
    if (length(d) > 1) look = normalized({d.x, std::clamp(d.y, -0.5f, 0.5f), d.z});
    shots.push_back({path[i], look, speed});
  }
}

// Turns on the spot, through the horizon.
void turn(std::vector<Shot>& shots, Vec3 to) {
  const Vec3 from = shots.back().look, eye = shots.back().eye;
  const float yaw0 = angleOf(from.z, from.x);
  float dyaw = angleOf(to.z, to.x) - yaw0;
  if (dyaw > kHalfTurn) dyaw -= 2 * kHalfTurn;
  if (dyaw < -kHalfTurn) dyaw += 2 * kHalfTurn;
  const auto pitchOf = [](Vec3 d) { return angleOf(d.y, std::sqrt(d.x * d.x + d.z * d.z)); };
  const float pitch0 = pitchOf(from), pitch1 = pitchOf(to);
  const int steps = 4 + static_cast<int>(std::abs(dyaw) * 12);
  for (int i = 1; i <= steps; ++i) {
    const float f = static_cast<float>(i) / static_cast<float>(steps);
    shots.push_back({eye, direction(yaw0 + f * dyaw, pitch0 + f * (pitch1 - pitch0)), 0});
  }
}

std::vector<Vec3> straight(Vec3 a, Vec3 b) {
  const int steps = std::max(1, static_cast<int>(length(b - a) / kStep));
  std::vector<Vec3> p;
  for (int i = 0; i <= steps; ++i) p.push_back(a + (b - a) * (static_cast<float>(i) / static_cast<float>(steps)));
  return p;
}

// The lowest air voxel at or above p: street furniture may stand at the street's end.
Int3 raised(const Voxels& v, Int3 p) {
  while (!v.air(p) && p.y < v.size().y - 1) ++p.y;
  return p;
}

}  // namespace

bool openAir(const Town& town, Vec3 point_m, float clearance) {
  const Vec3 origin{static_cast<float>(town.origin.x), static_cast<float>(town.origin.y),
                    static_cast<float>(town.origin.z)};
  return clear(town.voxels, point_m / town.cell_m - origin, clearance);
}

Result<CameraPath> flyThrough(const Town& town, double seconds) {
  const Voxels& v = town.voxels;
  const Error no_way{ErrorCode::kUsage, "", "", "the town has no building that can be entered", "try another --seed"};
  const Int3 start = raised(v, town.street_from);
  const Int3 size = v.size();
  std::vector<Entrance> doors = town.entrances;
  const auto from_middle = [&](const Entrance& e) {
    return std::abs(2 * e.outside.x - size.x) + std::abs(2 * e.outside.z - size.z);
  };
  std::ranges::stable_sort(doors, {}, from_middle);
  for (const Entrance& door : doors) {
    const Int3 up{0, 1, 0};
    // Beside the lamp, at eye level: under it the picture would show only its underside.
    Int3 room = door.inside + up;
    for (const Int3& d : {Int3{2, -1, 0}, Int3{-2, -1, 0}, Int3{0, -1, 2}, Int3{0, -1, -2}, Int3{1, -1, 1}})
      if (v.air(door.lamp + d) && walk(v, door.inside + up, door.lamp + d)) {
        room = door.lamp + d;
        break;
      }
    const auto street = walk(v, start, door.outside + up);
    const auto into = walk(v, door.outside + up, room);
    if (!street || !into) continue;

    std::vector<Vec3> way_in = *street;
    way_in.insert(way_in.end(), into->begin() + 1, into->end());
    std::vector<Vec3> way_out(into->rbegin(), into->rend());
    const Int3 high = {door.outside.x + 2 * (door.outside.x - door.inside.x), size.y - 1,
                       door.outside.z + 2 * (door.outside.z - door.inside.z)};
    const auto rise = walk(v, door.outside + up, {std::clamp(high.x, 1, size.x - 2), size.y - 1,
                                                 std::clamp(high.z, 1, size.z - 2)});
    if (!rise) continue;

    std::vector<Shot> shots;
    follow(shots, smoothed(v, way_in), 4);
    std::vector<Shot> leaving;
    follow(leaving, smoothed(v, way_out), 3);
    turn(shots, leaving.front().look);
    shots.insert(shots.end(), leaving.begin(), leaving.end());
    const Vec3 centre = middle({size.x / 2, town.ground + 2, size.z / 2});
    const Vec3 top = rise->back();
    const Vec3 far{static_cast<float>(size.x) * 0.1f, static_cast<float>(size.y) + 8, static_cast<float>(size.z) * 0.1f};
    std::vector<Vec3> over = smoothed(v, *rise);
    const std::vector<Vec3> glide = straight(top, far);
    over.insert(over.end(), glide.begin() + 1, glide.end());
    const auto toCentre = [&](Vec3 eye) {
      const Vec3 d = centre - eye;
      const float flat = std::max(std::sqrt(d.x * d.x + d.z * d.z), 6.0f);
      return direction(angleOf(d.z, d.x), std::max(angleOf(d.y, flat), -1.0f));
    };
    turn(shots, toCentre(over.front()));
    for (const Vec3& eye : over) shots.push_back({eye, toCentre(eye), 9});

    // Steady turning: the mean direction of a window of keys.
    CameraPath path;
    const Vec3 origin{static_cast<float>(town.origin.x), static_cast<float>(town.origin.y),
                      static_cast<float>(town.origin.z)};
    double t = 0;
    for (size_t i = 0; i < shots.size(); ++i) {
      constexpr size_t kWindow = 8;
      Vec3 look;
      for (size_t k = i > kWindow ? i - kWindow : 0; k < std::min(i + kWindow + 1, shots.size()); ++k) look += shots[k].look;
      look = length(look) > 0.1f ? normalized(look) : shots[i].look;
      if (i > 0) t += shots[i].speed > 0 ? length(shots[i].eye - shots[i - 1].eye) / shots[i].speed : 0.07;
      const Vec3 eye = (shots[i].eye + origin) * town.cell_m;
      path.keys.push_back({t, eye, eye + look * (4 * town.cell_m)});
    }
    for (CameraKey& key : path.keys) key.t *= seconds / t;
    if (std::ranges::all_of(path.keys, [&](const CameraKey& k) { return openAir(town, k.eye, kClearance); })) return path;
  }
  return no_way;
}

std::string cameraJson(const CameraPath& path) {
  using nlohmann::json;
  const auto rounded = [](double x) { return std::round(x * 1000) / 1000; };
  const auto triple = [&](Vec3 p) { return json::array({rounded(p.x), rounded(p.y), rounded(p.z)}); };
  json keys = json::array();
  for (const CameraKey& k : path.keys) keys.push_back({{"t", rounded(k.t)}, {"eye", triple(k.eye)}, {"target", triple(k.target)}});
  const json out = {{"fps", path.fps},
                    {"keys", keys},
                    {"sun", {{"direction", {0.512, 0.768, 0.384}}, {"irradiance", {13.0, 11.8, 9.6}}}},
                    {"sky", {{"l0", {0.9, 1.15, 1.5}}, {"zenith", {0.1, 0.3, 0.6}}}}};
  return out.dump() + "\n";
}

}  // namespace ff::tools
