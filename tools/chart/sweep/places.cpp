#include "tools/chart/sweep/places.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "tools/chart/sweep/running_cut.h"

namespace ff::chart {
namespace {

constexpr size_t kFewestPatches = 40;  // within reach of a place

// The lamps nearest to an observer: an emitting patch and all that follow from one to the next within two cells.
std::optional<Lighting> oneRoomLit(const Lighting& lamps, const MeasuredWorld& world, std::span<const Place> places) {
  std::vector<const formats::Node*> emitters;
  for (const formats::Node& n : world.patches())
    if (!(n.emission == Vec3{})) emitters.push_back(&n);
  size_t first = 0;
  float nearest = std::numeric_limits<float>::infinity();
  for (size_t e = 0; e < emitters.size(); ++e)
    for (const Place& place : places)
      if (const float d = length(emitters[e]->centroid - place.observer); d < nearest) nearest = d, first = e;
  const float reach = 2 * world.world().info().cell_m;
  std::vector<bool> lit(emitters.size(), false);
  std::vector<size_t> next;
  if (!emitters.empty()) next.push_back(first), lit[first] = true;
  Lighting one = lamps;
  one.name = "one room lit";
  one.lit = Box{};
  size_t count = next.size();
  while (!next.empty()) {
    const size_t e = next.back();
    next.pop_back();
    one.lit.add(emitters[e]->centroid);
    for (size_t f = 0; f < emitters.size(); ++f)
      if (!lit[f] && length(emitters[f]->centroid - emitters[e]->centroid) < reach) lit[f] = true, ++count, next.push_back(f);
  }
  if (count == 0 || count == emitters.size()) return std::nullopt;  // no lamp, or all of them are one
  const float half = world.world().info().cell_m / 2;
  one.lit = {one.lit.lo - Vec3{half, half, half}, one.lit.hi + Vec3{half, half, half}};
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
      const formats::Node& node = patches[patches.size() * (2 * k + 1) / (4 * wanted)];
      // Ten cells a second along the surface: a man's run through a town of 1 m.
      const Vec3 along = normalized(cross(node.normal, std::abs(node.normal.y) < 0.7f ? Vec3{0, 1, 0} : Vec3{1, 0, 0}));
      candidates.push_back({node.centroid + node.normal * (0.5f * standard.bake.cell_m), along * (10 * standard.bake.cell_m), 0});
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
      if (auto one = oneRoomLit(light, world, places)) lights.push_back(*one);
  }
  return lights;
}

}  // namespace ff::chart
