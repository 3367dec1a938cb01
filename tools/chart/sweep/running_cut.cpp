#include "tools/chart/sweep/running_cut.h"

#include <algorithm>
#include <cmath>

#include "runtime/clock.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/dense_solver.h"
#include "runtime/solver/converge.h"
#include "runtime/updater.h"
#include "tools/chart/outside.h"

namespace ff::chart {
namespace {

using namespace runtime;

Result<std::unique_ptr<BounceMatrix>> makeMatrix(const Knobs& knobs) {
  MultibounceSettings settings;
  settings.places = knobs.places;
  settings.storage = knobs.method == Method::kMultibounceHalf ? Storage::kFloat16 : Storage::kFloat32;
  settings.luminance = knobs.method == Method::kMultibounceLuminance;
  if (knobs.method == Method::kSeed) return makeCpuSeed(settings);
  if (knobs.method == Method::kPlainLocal) return makeCpuPlainLocal(settings);
  return makeCpuMultibounce(settings);
}

}  // namespace

Result<RunningCut> RunningCut::create(const MeasuredWorld& world, const Knobs& knobs) {
  RunningCut cut;
  cut.world_ = &world;
  cut.knobs_ = knobs;
  auto streamer = stream::Streamer::create(world.world(), {.radius_m = knobs.radius_m,
                                                           .growth = knobs.growth,
                                                           .max_level0_nodes = knobs.max_patches});
  if (!streamer) return streamer.error();
  cut.streamer_ = std::move(*streamer);
  cut.assembler_ =
      std::make_unique<MatrixAssembler>(world.world(), knobs.pyramid ? FarLight::kPyramid : FarLight::kConstant);
  if (!isDense(knobs.method)) {
    cut.solver_ = makeCpuGather();
  } else {
    auto matrix = makeMatrix(knobs);
    if (!matrix) return matrix.error();
    cut.dense_bytes_ = (*matrix)->bytes();
    const bool baseline = knobs.method == Method::kSeed || knobs.method == Method::kPlainLocal;
    cut.solver_ = makeDenseSolver(std::move(*matrix), {.correct = !baseline});
  }
  return cut;
}

Result<void> RunningCut::moveTo(Vec3 observer) {
  observer_ = observer;
  streamer_->update(observer, {});
  if (auto settled = streamer_->settle(); !settled) return settled.error();
  if (auto updated = assembler_->update(streamer_->active()); !updated) return updated.error();
  return solver_->update(assembler_->matrix(), assembler_->change());
}

Result<void> RunningCut::setLight(const LitWorld& light) {
  const LocalMatrix& m = assembler_->matrix();
  source_.assign(m.slots(), {});
  std::vector<Vec3> lamps;
  for (size_t t = 0; t < m.tiles.size(); ++t) {
    const SlotRange& range = m.tiles[t];
    const std::span<const Vec3> sun = light.sun.tile(world_->world(), range.id);
    lamps.resize(range.nodes);
    light.lamps.irradiance(assembler_->strip(t).lamps, lamps);
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const formats::Node& node = assembler_->strip(t).nodes[i];
      const Vec3 b = node.albedo * (sun[i] + lamps[i] + skyIrradiance(light.light.sky, node));
      source_[range.first_slot + i] = {b.x, b.y, b.z, 0};
    }
  }
  if (m.ambient_slot != kNoSlot)
    source_[m.ambient_slot] = Outside(world_->patches().size(), m.tiles).meanRadiosity(world_->areasM2(), light.full);
  return solver_->setSource(source_);
}

Result<void> RunningCut::step(int k) { return solver_->iterate(k); }

Result<runtime::Settled> RunningCut::settle() {
  before_.resize(source_.size());
  radiosity_.resize(source_.size());
  return converge(*solver_, {.fewest = isDense(knobs_.method) ? 2 : Convergence{}.fewest}, radiosity_, before_);
}

Result<std::vector<double>> RunningCut::irradiance(const LitWorld& light, std::span<const uint32_t> patches) {
  const LocalMatrix& m = assembler_->matrix();
  radiosity_.resize(m.slots());
  if (auto r = solver_->radiosity(radiosity_); !r) return r.error();
  std::vector<double> out;
  out.reserve(3 * patches.size());
  for (const uint32_t patch : patches) {
    uint32_t slot = m.slotOf(0, patch), node = patch;
    for (uint32_t level = 0; slot == kNoSlot && level + 1 < world_->world().levels().size(); ++level) {
      node = world_->world().parent(level, node);
      slot = m.slotOf(level + 1, node);
    }
    // A constant far light has no ancestors: such a patch gets its direct light alone.
    const Vec4 all = slot != kNoSlot ? radiosity_[slot] : Vec4{}, source = slot != kNoSlot ? source_[slot] : Vec4{},
               rho = slot != kNoSlot ? m.albedo[slot] : Vec4{1, 1, 1, 0};
    const float b[3] = {all.x, all.y, all.z}, own[3] = {source.x, source.y, source.z}, albedo[3] = {rho.x, rho.y, rho.z};
    for (int c = 0; c < 3; ++c) {
      const auto direct = static_cast<double>(light.direct[patch][c]);
      if (albedo[c] > 0) out.push_back(direct + (static_cast<double>(b[c]) - static_cast<double>(own[c])) / static_cast<double>(albedo[c]));
      else out.push_back(light.irradiance.empty() ? direct : light.irradiance[3 * size_t{patch} + static_cast<size_t>(c)]);
    }
  }
  return out;
}

Result<std::vector<double>> RunningCut::reflected(const LitWorld& light, std::span<const uint32_t> patches) {
  auto out = irradiance(light, patches);
  if (!out) return out;
  for (size_t k = 0; k < out->size(); ++k)
    (*out)[k] *= static_cast<double>(world_->patches()[patches[k / 3]].albedo[static_cast<int>(k % 3)]);
  return out;
}

Result<double> RunningCut::timeFrame() {
  if (auto first = step(knobs_.iterations); !first) return first.error();  // the other one has had the caches
  const auto start = Clock::now();
  if (auto stepped = step(knobs_.iterations); !stepped) return stepped.error();
  return msSince(start);
}

Result<void> RunningCut::timeRelight(int samples, RunningCut& yardstick, CutCost& cost, std::vector<double>& yardstick_ms) {
  for (int i = 0; i < samples; ++i) {
    const auto standard = yardstick.timeFrame();
    if (!standard) return standard.error();
    const auto own = timeFrame();
    if (!own) return own.error();
    yardstick_ms.push_back(*standard);
    cost.relight.push_back(*own / *standard);
  }
  return {};
}

Result<void> RunningCut::timeWalk(Vec3 from, Vec3 direction, int steps, CutCost& cost) {
  const float cell = world_->world().info().cell_m;
  for (int i = 1; i <= steps; ++i) {
    streamer_->update(from + direction * (cell * static_cast<float>(i)), {});
    if (auto settled = streamer_->settle(); !settled) return settled.error();
    const auto start = Clock::now();
    if (auto updated = assembler_->update(streamer_->active()); !updated) return updated.error();
    if (assembler_->change().any)
      if (auto updated = solver_->update(assembler_->matrix(), assembler_->change()); !updated) return updated.error();
    const double ms = msSince(start);
    if (assembler_->change().renumbered) continue;  // a whole new matrix is no tile
    uint32_t entered = 0;
    for (const uint32_t t : assembler_->change().entered)
      if (assembler_->matrix().tiles[t].id.level == 0) entered += assembler_->matrix().tiles[t].nodes;
    if (entered == 0) continue;
    cost.update_ms += ms;
    cost.tiles += static_cast<double>(entered) / formats::kTileNodes;
  }
  return {};
}

void RunningCut::measureMemory(CutCost& cost) const {
  const LocalMatrix& m = assembler_->matrix();
  cost.active_nodes = static_cast<uint32_t>(m.leaves.size());
  cost.entries = static_cast<uint32_t>(m.used_entries);
  cost.patches = 0;
  for (const SlotRange& range : m.tiles)
    if (range.id.level == 0) cost.patches += range.nodes;
  cost.memory_bytes = static_cast<double>(m.used_entries) * sizeof(uint32_t) +
                      static_cast<double>(m.slots()) * (3 * sizeof(uint32_t) + 3 * sizeof(Vec4)) +
                      static_cast<double>(dense_bytes_ + streamer_->stats().resident_bytes);
}

float RunningCut::localRadius() const {
  return Outside(world_->patches().size(), assembler_->matrix().tiles).distance(observer_, world_->patches());
}

}  // namespace ff::chart
