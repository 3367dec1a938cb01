#include "tools/chart/sweep/measured_world.h"

#include <algorithm>
#include <numeric>

#include "formats/read/whole_world.h"
#include "runtime/full_solve.h"

namespace ff::chart {

bool isSeen(std::span<const Place> places, size_t at, const Lighting& light) {
  const bool own = std::any_of(places.begin(), places.end(), [&](const Place& p) { return p.in_light == light.name; });
  return places[at].in_light == (own ? light.name : "");
}

Result<MeasuredWorld> MeasuredWorld::open(const bake::Scene& scene, const std::string& path) {
  auto world = formats::WholeWorld::open(path);
  if (!world) return world.error();
  MeasuredWorld m;
  m.world_ = std::make_unique<formats::WholeWorld>(std::move(*world));
  auto tracer = PathTracer::create(scene, *m.world_);
  if (!tracer) return tracer.error();
  m.tracer_ = std::make_unique<PathTracer>(std::move(*tracer));
  for (const formats::TileInfo& info : m.world_->tiles(0)) {
    const auto strip = m.world_->strip(info.id);
    if (!strip) return strip.error();
    for (const formats::Node& node : strip->nodes) {
      m.nodes_.push_back(node);
      m.areas_m2_.push_back(node.area_m2);
    }
  }
  return m;
}

uint64_t MeasuredWorld::rowBytes() const {
  uint64_t bytes = 0;
  for (const formats::LevelInfo& level : world_->levels()) bytes += level.stored_bytes;
  return bytes;
}

void MeasuredWorld::lookAt(std::span<const Place> places, uint32_t most) {
  looked_at_.clear();
  of_place_.assign(places.size(), {});
  std::vector<uint32_t> number(nodes_.size(), bake::kNone), near;
  for (size_t at = 0; at < places.size(); ++at) {
    near.clear();
    const Place& place = places[at];
    uint32_t nearest = bake::kNone;
    float distance = place.reach_m;
    for (uint32_t p = 0; p < nodes_.size(); ++p) {
      const float d = length(nodes_[p].centroid - place.observer);
      if (d > place.reach_m) continue;
      if (place.within.distance(nodes_[p].centroid) == 0) near.push_back(p);
      if (nearest == bake::kNone || d < distance) nearest = p, distance = d;
    }
    if (near.empty() && nearest != bake::kNone) near.push_back(nearest);
    const size_t count = std::min<size_t>(most, near.size());
    for (size_t k = 0; k < count; ++k) {
      const uint32_t patch = near[near.size() * (2 * k + 1) / (2 * count)];
      if (number[patch] == bake::kNone) {
        number[patch] = static_cast<uint32_t>(looked_at_.size());
        looked_at_.push_back(patch);
      }
      of_place_[at].push_back(number[patch]);
    }
  }
  for (auto& [key, lit] : lit_)
    if (lit) lit->traced.clear();
}

Result<LitWorld> MeasuredWorld::direct(const Lighting& light, uint32_t shadow_rays) const {
  LitWorld made;
  made.light = light;
  std::vector<uint32_t> all(nodes_.size());
  std::iota(all.begin(), all.end(), 0u);
  const std::vector<Vec3> sun = tracer_->sunIrradiance(all, light, shadow_rays);
  made.lamps = light.switches(world_->info());
  auto direct = runtime::arriving(*world_, sun, light.sky, made.lamps);
  if (!direct) return direct.error();
  made.direct = std::move(*direct);
  made.source.reserve(3 * nodes_.size());
  for (size_t p = 0; p < nodes_.size(); ++p)
    for (int c = 0; c < 3; ++c) made.source.push_back(static_cast<double>(nodes_[p].albedo[c] * made.direct[p][c]));
  made.sun = runtime::aggregateUp(*world_, areas_m2_, sun);
  return made;
}

Result<const LitWorld*> MeasuredWorld::lit(const Lighting& light, uint32_t shadow_rays, const TraceSettings* trace) {
  std::unique_ptr<LitWorld>& kept = lit_[{light.name, shadow_rays}];
  if (!kept) {
    auto lit_directly = direct(light, shadow_rays);
    if (!lit_directly) return lit_directly.error();
    auto made = std::make_unique<LitWorld>(std::move(*lit_directly));
    auto full = runtime::solveFullWorld(*world_, made->source);
    if (!full) return full.error();
    made->full = std::move(full->radiosity);
    made->irradiance = std::move(full->gathered);
    for (size_t k = 0; k < made->irradiance.size(); ++k)
      made->irradiance[k] += static_cast<double>(made->direct[k / 3][static_cast<int>(k % 3)]);
    kept = std::move(made);
  }
  if (trace && kept->traced.empty()) kept->traced = tracer_->trace(looked_at_, light, *trace);
  return kept.get();
}

}  // namespace ff::chart
