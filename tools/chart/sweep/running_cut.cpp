#include "tools/chart/sweep/running_cut.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "runtime/converge.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/dense_solver.h"
#include "runtime/updater.h"
#include "tools/chart/outside.h"

namespace ff::chart {
namespace {

using namespace runtime;
using Clock = std::chrono::steady_clock;

double msSince(Clock::time_point t) { return std::chrono::duration<double, std::milli>(Clock::now() - t).count(); }

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
  for (size_t t = 0; t < m.tiles.size(); ++t) {
    const SlotRange& range = m.tiles[t];
    const std::span<const Vec3> sun = light.sun.tile(world_->world(), range.id),
                                lamps = light.lamps.tile(world_->world(), range.id);
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const formats::Node& node = assembler_->strip(t).nodes[i];
      const Vec3 b = lamps[i] + node.albedo * (sun[i] + skyIrradiance(light.light.sky, node));
      source_[range.first_slot + i] = {b.x, b.y, b.z, 0};
    }
  }
  if (m.ambient_slot != kNoSlot)
    source_[m.ambient_slot] = Outside(world_->patches().size(), m.tiles).meanRadiosity(world_->areasM2(), light.full);
  return solver_->setSource(source_);
}

Result<void> RunningCut::step(int k) { return solver_->iterate(k); }

Result<int> RunningCut::settle() {
  before_.resize(source_.size());
  radiosity_.resize(source_.size());
  return converge(*solver_, {.fewest = isDense(knobs_.method) ? 2 : Convergence{}.fewest}, radiosity_, before_);
}

Result<std::vector<double>> RunningCut::reflected(const LitWorld& light, std::span<const uint32_t> patches) {
  const LocalMatrix& m = assembler_->matrix();
  radiosity_.resize(m.slots());
  if (auto r = solver_->radiosity(radiosity_); !r) return r.error();
  std::vector<double> out;
  out.reserve(3 * patches.size());
  for (const uint32_t patch : patches) {
    const formats::Node& own = world_->patches()[patch];
    uint32_t slot = m.slotOf(0, patch), node = patch;
    Vec3 b;
    if (slot != kNoSlot) {
      b = Vec3{radiosity_[slot].x, radiosity_[slot].y, radiosity_[slot].z} - light.lamps.mean[0][patch];
    } else {
      for (uint32_t level = 0; slot == kNoSlot && level + 1 < world_->world().levels().size(); ++level) {
        node = world_->world().parent(level, node);
        slot = m.slotOf(level + 1, node);
      }
      // Irradiance from surfaces: what is left of the ancestor's radiosity, by its albedo. A constant far light has no
      // ancestors: such a patch gets its direct light alone.
      b = own.albedo * (light.sun.mean[0][patch] + skyIrradiance(light.light.sky, own));
      if (slot != kNoSlot) {
        const Vec4 all = radiosity_[slot], direct = source_[slot], rho = m.albedo[slot];
        const auto irradiance = [](float x, float y, float r) { return r > 0 ? (x - y) / r : 0.0f; };
        b += own.albedo * Vec3{irradiance(all.x, direct.x, rho.x), irradiance(all.y, direct.y, rho.y),
                               irradiance(all.z, direct.z, rho.z)};
      }
    }
    for (int c = 0; c < 3; ++c) out.push_back(static_cast<double>(b[c]));
  }
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
