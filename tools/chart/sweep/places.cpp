#include "tools/chart/sweep/places.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "tools/chart/sweep/running_cut.h"

namespace ff::chart {
namespace {

constexpr size_t kFewestPatches = 40;  // within reach of a place
constexpr double kLeastLit = 0.05;     // of the mean brightness that a light finds
constexpr float kTouching = 1.8f;      // cells between patches that touch, at most
constexpr int kCuts = 3;               // of a lit surface
constexpr size_t kFewestLit = 4;       // patches of a part of it
constexpr float kMargin = 0.01f;       // cells around a part; centroids of one plane differ by less, as tiles round them each its own way

// Off a patch, running along it at ten cells a second: a man's run through a town of 1 m.
Place placeOff(const formats::Node& node, float away_m, float cell_m) {
  const Vec3 along = normalized(cross(node.normal, std::abs(node.normal.y) < 0.7f ? Vec3{0, 1, 0} : Vec3{1, 0, 0}));
  return {node.centroid + node.normal * away_m, along * (10 * cell_m), 0};
}

// Patches with their share of the light: area times the square of what they reflect.
struct LitPatch {
  const formats::Node* node;
  double share;
};
using LitSurface = std::vector<LitPatch>;

LitSurface litSurface(const LitWorld& lit, const std::vector<formats::Node>& patches, float touching_m) {
  std::vector<double> b(patches.size(), 0);
  double power = 0, squares = 0, most = 0;
  size_t brightest = 0;
  for (size_t p = 0; p < patches.size(); ++p) {
    for (size_t c = 0; c < 3; ++c) b[p] += lit.full[3 * p + c];
    const double reflected = static_cast<double>(patches[p].area_m2) * b[p];
    power += reflected;
    squares += reflected * b[p];
    if (reflected > most) most = reflected, brightest = p;
  }
  LitSurface surface;
  if (!(most > 0)) return surface;
  // A ray that met the lamp by chance lights up a patch far away: only what touches counts.
  const double least = kLeastLit * squares / power;
  using Block = std::array<int, 3>;
  const auto blockOf = [&](Vec3 at) {
    return Block{static_cast<int>(std::floor(at.x / touching_m)), static_cast<int>(std::floor(at.y / touching_m)),
                 static_cast<int>(std::floor(at.z / touching_m))};
  };
  std::map<Block, std::vector<size_t>> waiting;
  for (size_t p = 0; p < patches.size(); ++p)
    if (p != brightest && b[p] >= least) waiting[blockOf(patches[p].centroid)].push_back(p);
  std::vector<size_t> found{brightest};
  while (!found.empty()) {
    const size_t from = found.back();
    found.pop_back();
    surface.push_back({&patches[from], static_cast<double>(patches[from].area_m2) * b[from] * b[from]});
    const Block block = blockOf(patches[from].centroid);
    for (int k = 0; k < 27; ++k) {
      const auto near = waiting.find({block[0] + k % 3 - 1, block[1] + k / 3 % 3 - 1, block[2] + k / 9 - 1});
      if (near == waiting.end()) continue;
      std::erase_if(near->second, [&](size_t p) {
        if (length(patches[p].centroid - patches[from].centroid) > touching_m) return false;
        found.push_back(p);
        return true;
      });
    }
  }
  return surface;
}

Box boxOf(const LitSurface& part, float margin_m) {
  Box box;
  for (const LitPatch& p : part) box.add(p.node->centroid);
  return {box.lo - Vec3{margin_m, margin_m, margin_m}, box.hi + Vec3{margin_m, margin_m, margin_m}};
}

// Across the longest side, each half with half of the share; as it is where a half would have too few patches.
void cutInTwo(LitSurface part, float margin_m, std::vector<LitSurface>& halves) {
  const Vec3 size = part.empty() ? Vec3{} : boxOf(part, 0).hi - boxOf(part, 0).lo;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.z >= size.y ? 2 : 1;
  const auto along = [&](const LitPatch& p) { return p.node->centroid[axis]; };
  std::stable_sort(part.begin(), part.end(), [&](const LitPatch& p, const LitPatch& q) {
    return std::pair(along(p), p.node) < std::pair(along(q), q.node);
  });
  double all = 0, before = 0;
  for (const LitPatch& p : part) all += p.share;
  // Between patches of different places, so that the boxes have no patch in common.
  size_t best = 0;
  double nearest = all;
  for (size_t i = 1; i < part.size(); ++i) {
    before += part[i - 1].share;
    if (i < kFewestLit || part.size() - i < kFewestLit || !(along(part[i]) - along(part[i - 1]) > 2 * margin_m)) continue;
    if (const double off = std::abs(before - all / 2); off < nearest) nearest = off, best = i;
  }
  if (best == 0) {
    halves.push_back(std::move(part));
    return;
  }
  const auto at = part.begin() + static_cast<std::ptrdiff_t>(best);
  halves.emplace_back(part.begin(), at);
  halves.emplace_back(at, part.end());
}

// The patch nearest to the middle, by share.
size_t middleOf(const LitSurface& part) {
  double all = 0, sum[3] = {0, 0, 0};
  for (const LitPatch& p : part) {
    all += p.share;
    for (int c = 0; c < 3; ++c) sum[c] += p.share * static_cast<double>(p.node->centroid[c]);
  }
  const Vec3 middle{static_cast<float>(sum[0] / all), static_cast<float>(sum[1] / all), static_cast<float>(sum[2] / all)};
  const auto nearer = [&](const LitPatch& p, const LitPatch& q) {
    return std::pair(length(p.node->centroid - middle), p.node) < std::pair(length(q.node->centroid - middle), q.node);
  };
  return static_cast<size_t>(std::min_element(part.begin(), part.end(), nearer) - part.begin());
}

// The lamp group of the emitting patch nearest to an observer; none where all lamps are of one group.
std::optional<Lighting> oneGroupLit(const Lighting& lamps, const MeasuredWorld& world, std::span<const Place> places) {
  if (world.world().info().lamp_groups.size() < 2) return std::nullopt;
  uint16_t group = formats::kNoLampGroup;
  float nearest = std::numeric_limits<float>::infinity();
  for (const formats::Node& n : world.patches()) {
    if (n.emission == Vec3{}) continue;
    for (const Place& place : places)
      if (const float d = length(n.centroid - place.observer); d < nearest) nearest = d, group = n.lamp_group;
  }
  if (group == formats::kNoLampGroup) return std::nullopt;
  Lighting one = lamps;
  one.name = kOneGroupLit;
  one.groups = {group};
  return one;
}

}  // namespace

Result<std::vector<Place>> placesOf(const SweepOptions& options, const MeasuredWorld& world, const Knobs& standard) {
  std::vector<Place> candidates = options.path;
  const size_t wanted = candidates.empty() ? static_cast<size_t>(options.observers) : candidates.size();
  const auto& patches = world.patches();
  if (candidates.empty())
    for (size_t i = 0; i < 2 * wanted; ++i) {  // twice as many: some will be in crevices
      // Every other one first, so that whatever is left out the rest is spread evenly.
      const size_t k = i < wanted ? 2 * i : 2 * (i - wanted) + 1;
      candidates.push_back(placeOff(patches[patches.size() * (2 * k + 1) / (4 * wanted)], 0.5f * standard.bake.cell_m, standard.bake.cell_m));
    }
  auto cut = RunningCut::create(world, standard);
  if (!cut) return cut.error();
  std::vector<Place> places;
  for (Place& place : candidates) {
    if (places.size() == wanted) break;
    if (auto moved = cut->moveTo(place.observer); !moved) return moved.error();
    place.reach_m = std::min(cut->localRadius() / 2, 24 * standard.bake.cell_m);
    const auto near = std::count_if(patches.begin(), patches.end(), [&](const formats::Node& n) {
      return length(n.centroid - place.observer) <= place.reach_m;
    });
    if (static_cast<size_t>(near) >= std::min(kFewestPatches, patches.size())) places.push_back(place);
  }
  if (places.empty())
    return Error{ErrorCode::kUsage, options.scene_path, "camera path", "no observer has surfaces within reach",
                 "lead the path through the scene, or leave it out"};
  return places;
}

std::vector<Lighting> lightsOf(const SweepOptions& options, const MeasuredWorld& world, std::span<const Place> places,
                               const Say& say) {
  std::vector<Lighting> lights;
  const bool any = std::any_of(world.patches().begin(), world.patches().end(),
                               [](const formats::Node& n) { return !(n.emission == Vec3{}); });
  for (const Lighting& light : options.lights) {
    if (light.lamps > 0 && !any) {
      say(light.name + ": the scene has none");
      continue;
    }
    lights.push_back(light);
    if (light.lamps > 0)
      if (auto one = oneGroupLit(light, world, places)) lights.push_back(*one);
  }
  return lights;
}

Result<std::vector<Place>> placesInLight(const Lighting& light, MeasuredWorld& world, const Knobs& standard) {
  const auto lit = world.lit(light, standard.shadow_rays, nullptr);
  if (!lit) return lit.error();
  const float cell = standard.bake.cell_m;
  std::vector<LitSurface> parts{litSurface(**lit, world.patches(), kTouching * cell)};
  for (int cut = 0; cut < kCuts; ++cut) {
    std::vector<LitSurface> halves;
    for (LitSurface& part : parts) cutInTwo(std::move(part), kMargin * cell, halves);
    parts = std::move(halves);
  }
  if (parts.size() < 2) return std::vector<Place>{};

  auto cut = RunningCut::create(world, standard);
  if (!cut) return cut.error();
  std::vector<Place> places;
  for (const LitSurface& part : parts) {
    const formats::Node& middle = *part[middleOf(part)].node;
    const float room = world.tracer().sight(middle.centroid + middle.normal * (0.01f * cell), middle.normal).distance_m;
    Place place = placeOff(middle, std::min(0.5f * cell, 0.5f * room), cell);
    place.in_light = light.name;
    place.within = boxOf(part, kMargin * cell);
    if (auto moved = cut->moveTo(place.observer); !moved) return moved.error();
    place.reach_m = std::min(cut->localRadius() / 2, 24 * cell);
    places.push_back(place);
  }
  return places;
}

}  // namespace ff::chart
