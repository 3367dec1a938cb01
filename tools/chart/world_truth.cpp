#include "tools/chart/world_truth.h"

#include <algorithm>
#include <utility>

#include "formats/read/whole_world.h"
#include "runtime/full_solve.h"
#include "tools/chart/outside.h"
#include "tools/chart/sun_light.h"

namespace ff::chart {

using namespace runtime;

Result<WorldTruth> solveWorldTruth(const formats::WholeWorld& world, bool lamps) {
  WorldTruth t;
  t.lamps = Lamps(world.info());
  if (!lamps) t.lamps.setAll({});
  const auto sun = sunIrradiance(world, normalized({0.4f, 0.8f, 0.3f}), {13.0f, 11.8f, 9.6f});
  if (!sun) return sun.error();
  auto areas = patchAreas(world);
  if (!areas) return areas.error();
  t.areas_m2 = std::move(*areas);
  t.sun = aggregateUp(world, t.areas_m2, *sun);
  for (const formats::TileInfo& info : world.tiles(0)) {
    auto strip = world.strip(info.id);
    if (!strip) return strip.error();
    t.patches.push_back(std::move(*strip));
  }
  const auto source = fullSource(world, *sun, t.sky, t.lamps);
  if (!source) return source.error();
  auto solved = solveFullWorld(world, *source);
  if (!solved) return solved.error();
  t.radiosity = std::move(solved->radiosity);
  for (const double b : t.radiosity) t.rms += b * b;
  t.rms = std::sqrt(t.rms / static_cast<double>(t.radiosity.size()));
  return t;
}

float localRadius(const WorldTruth& truth, std::span<const stream::StripPtr> active, Vec3 observer) {
  const Outside outside(truth.areas_m2.size(), active);
  float radius = 1e30f;
  for (const formats::Strip& strip : truth.patches)
    radius = std::min(radius, outside.distance(observer, strip.nodes, strip.first_node));
  return radius;
}

Difference compare(const WorldTruth& truth, const LocalMatrix& matrix, std::span<const Vec4> radiosity,
                   std::span<const Vec4> source, const Case& at) {
  Difference d;
  for (const SlotRange& range : matrix.tiles) {
    if (range.id.level != 0) break;
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const formats::Node& node = truth.patches[range.id.tile].nodes[i];
      if (length(node.centroid - at.observer) > at.local_radius_m / 2) continue;
      ++d.patches;
      const Vec4 b = radiosity[range.first_slot + i], m = source[range.first_slot + i];
      const double x[3] = {b.x, b.y, b.z}, direct[3] = {m.x, m.y, m.z};
      for (int c = 0; c < 3; ++c) {
        const double full = truth.radiosity[3 * size_t{range.first_node + i} + static_cast<size_t>(c)];
        d.reflected += (x[c] - full) * (x[c] - full);
        d.reflected_truth += full * full;
        d.bounced += (full - direct[c]) * (full - direct[c]);
      }
    }
  }
  return d;
}

Vec4 meanOutside(const WorldTruth& truth, const LocalMatrix& matrix) {
  return Outside(truth.areas_m2.size(), matrix.tiles).meanRadiosity(truth.areas_m2, truth.radiosity);
}

std::vector<Vec4> sourceOf(const WorldTruth& truth, const formats::WholeWorld& world, const LocalMatrix& matrix,
                           std::span<const stream::StripPtr> active) {
  std::vector<Vec4> source(matrix.slots());
  std::vector<Vec3> lamps;
  size_t t = 0;
  for (const auto& strip : active) {
    if (t == matrix.tiles.size() || matrix.tiles[t].id != strip->id) continue;
    const SlotRange& range = matrix.tiles[t++];
    const std::span<const Vec3> sun = truth.sun.tile(world, range.id);
    lamps.resize(range.nodes);
    truth.lamps.irradiance(strip->lamps, lamps);
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const formats::Node& node = strip->nodes[i];
      const Vec3 m = node.albedo * (sun[i] + lamps[i] + skyIrradiance(truth.sky, node));
      source[range.first_slot + i] = {m.x, m.y, m.z, 0};
    }
  }
  return source;
}

std::vector<Vec3> observersOf(const WorldTruth& truth, int count, float cell_m) {
  std::vector<Vec3> observers;
  for (int k = 0; k < count; ++k) {
    const size_t patch = truth.areas_m2.size() * (2 * static_cast<size_t>(k) + 1) / (2 * static_cast<size_t>(count));
    for (const formats::Strip& strip : truth.patches)
      if (patch >= strip.first_node && patch < strip.first_node + strip.nodes.size()) {
        const formats::Node& node = strip.nodes[patch - strip.first_node];
        observers.push_back(node.centroid + node.normal * (0.5f * cell_m));
      }
  }
  return observers;
}

}  // namespace ff::chart
