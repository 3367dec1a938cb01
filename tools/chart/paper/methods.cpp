#include "tools/chart/paper/methods.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "formats/read/whole_world.h"
#include "runtime/clock.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/solver/solver.h"
#include "runtime/solver/worker_pool.h"
#include "tools/chart/read_bandwidth.h"
#include "tools/chart/report.h"
#include "tools/view/picture.h"

namespace ff::chart {

using namespace runtime;
using namespace walks;

namespace {

template <class Step>
Result<double> msOf(const Step& step) {
  const auto began = Clock::now();
  if (Result<void> done = step(); !done) return done.error();
  return msSince(began);
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return kNotMeasured;
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<size_t>(share * static_cast<double>(values.size())))];
}

template <class Step>
Result<double> medianMs(int repeats, const Step& step) {
  std::vector<double> ms;
  for (int i = 0; i < repeats; ++i) {
    const auto one = msOf(step);
    if (!one) return one;
    ms.push_back(*one);
  }
  return quantile(ms, 0.5);
}

// Within a round. Others may be using the machine: a median takes what they do out.
constexpr int kRelights = 5, kSteps = 15;

struct Lit {
  float radiosity[3], truth[3];
  double area_m2;
};

// Active patches with what a method says of them, and what is true.
template <class Visit>
void eachPatch(const WorldTruth& truth, const LocalMatrix& matrix, std::span<const Vec4> radiosity,
               const Visit& visit) {
  for (const SlotRange& range : matrix.tiles) {
    if (range.id.level != 0) break;
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const Vec4 b = radiosity[range.first_slot + i];
      const size_t patch = range.first_node + i;
      Lit lit{{b.x, b.y, b.z}, {}, static_cast<double>(truth.areas_m2[patch])};
      for (size_t c = 0; c < 3; ++c) lit.truth[c] = static_cast<float>(truth.radiosity[3 * patch + c]);
      visit(lit);
    }
  }
}

void compareAll(const WorldTruth& truth, const LocalMatrix& matrix, std::span<const Vec4> radiosity,
                std::span<const Vec4> source, const Case& at, MethodCost& cost) {
  std::vector<Vec4> shown;
  eachPatch(truth, matrix, radiosity, [&](const Lit& lit) {
    shown.push_back({lit.truth[0], lit.truth[1], lit.truth[2], 1});
  });
  const float exposure = std::exp2(view::exposureStops(shown));
  double area = 0, mean = 0;
  eachPatch(truth, matrix, radiosity, [&](const Lit& lit) {
    area += 3 * lit.area_m2;
    for (size_t c = 0; c < 3; ++c) {
      const float b = lit.radiosity[c], t = lit.truth[c];
      cost.linear += lit.area_m2 * static_cast<double>(std::abs(b - t));
      mean += lit.area_m2 * static_cast<double>(t);
      cost.picture +=
          lit.area_m2 * static_cast<double>(std::abs(view::toneCurve(exposure * b) - view::toneCurve(exposure * t)));
    }
  });
  cost.linear = mean > 0 ? cost.linear / mean : 0;
  cost.picture = area > 0 ? cost.picture / area : 0;
  cost.inner = compare(truth, matrix, radiosity, source, at);
}

// A dense method on its way through the rounds.
struct Dense {
  MethodCost cost;
  std::unique_ptr<BounceMatrix> matrix;
  std::unique_ptr<Placement> at;
  uint32_t block = 1;  // patches that leave and enter in one step
  std::vector<double> relight{}, update{};
};

// The block's patches leave and come back.
Result<double> swapMs(Dense& dense, uint32_t first) {
  std::vector<uint32_t> some(dense.block);
  std::iota(some.begin(), some.end(), first);
  const auto places = dense.at->leave(some);
  const auto left = msOf([&] { return dense.matrix->remove(places); });
  if (!left) return left;
  const EnteringBlock block = dense.at->enter(some);
  const auto entered = msOf([&] { return dense.matrix->insert(block); });
  if (!entered) return entered;
  return (*left + *entered) / dense.block;
}

// A level-0 tile leaves the cut and comes back, by patch: matrix and solver. Not where level 0 is the top, which never
// leaves.
Result<double> tileSwapMs(const formats::WholeWorld& world, const Neighbourhood& there, int threads, int most) {
  if (world.levels().size() == 1) return kNotMeasured;
  const auto active = there.streamer->active();
  MatrixAssembler assembler(world);
  const auto solver = makeCpuGather(threads);
  const auto take = [&](std::span<const stream::StripPtr> cut) -> Result<void> {
    if (auto updated = assembler.update(cut); !updated) return updated;
    return solver->update(assembler.matrix(), assembler.change());
  };
  if (auto taken = take(active); !taken) return taken.error();
  std::vector<double> ms;
  std::vector<stream::StripPtr> without;
  for (size_t t = 0; t < active.size() && active[t]->id.level == 0 && static_cast<int>(ms.size()) < most; ++t) {
    without.assign(active.begin(), active.end());
    without.erase(without.begin() + static_cast<std::ptrdiff_t>(t));
    const auto took = msOf([&]() -> Result<void> {
      if (auto left = take(without); !left) return left;
      return take(active);
    });
    if (!took) return took;
    ms.push_back(*took / static_cast<double>(active[t]->nodes.size()));
  }
  return quantile(ms, 0.5);
}

}  // namespace

Result<Neighbourhood> nearestPatches(const formats::WholeWorld& world, const WorldTruth& truth, Vec3 observer,
                                     uint32_t patches) {
  std::vector<float> away;
  for (const formats::Strip& strip : truth.patches)
    for (const formats::Node& node : strip.nodes) away.push_back(length(node.centroid - observer));
  const size_t last = std::min<size_t>(patches, away.size()) - 1;
  std::nth_element(away.begin(), away.begin() + static_cast<std::ptrdiff_t>(last), away.end());
  return neighbourhoodAt(world, truth, observer,
                         {.radius_m = away[last], .hysteresis = 1, .max_level0_nodes = patches});
}

Result<MethodsThere> measureMethods(const formats::WholeWorld& world, const WorldTruth& truth, const Neighbourhood& there,
                                    const MethodSettings& settings) {
  const auto local = localPatches(world, truth, there);
  if (!local) return local.error();
  const uint32_t patches = local->patches();
  const MultibounceSettings fp32{.places = settings.patches, .threads = settings.threads};
  MultibounceSettings fp16 = fp32;
  fp16.storage = Storage::kFloat16;
  std::vector<Dense> dense;
  const auto add = [&](const char* name, Result<std::unique_ptr<BounceMatrix>> matrix, uint32_t block) -> Result<void> {
    if (!matrix) return matrix.error();
    Dense& d = dense.emplace_back();
    d.cost.name = name;
    d.matrix = std::move(*matrix);
    d.at = std::make_unique<Placement>(local->set, settings.patches);
    d.block = std::min(block, patches);
    return {};
  };
  if (auto ok = add(kSeedName, makeCpuSeed(fp32), 1); !ok) return ok.error();
  if (auto ok = add(kExactFloatName, makeCpuMultibounce(fp32), kMaxBlock); !ok) return ok.error();
  if (auto ok = add(kExactName, makeCpuMultibounce(fp16), kMaxBlock); !ok) return ok.error();
  if (auto ok = add(kCommonName, makeCpuPlainLocal(fp32), kMaxBlock); !ok) return ok.error();
  for (Dense& d : dense) {
    if (auto filled = fillMatrix(*d.matrix, *d.at, patches, kMaxBlock); !filled) return filled.error();
    const auto radiosity = relitRadiosity(*local, *d.at, *d.matrix);
    if (!radiosity) return radiosity.error();
    compareAll(truth, local->matrix, *radiosity, local->slot_source, there.at, d.cost);
    d.cost.patches = patches;
    d.cost.bytes = static_cast<double>(d.matrix->bytes());
  }
  MethodCost gathered{.name = kGatherName};
  const auto gather = makeCpuGather(settings.threads);
  if (auto lit = lightUp(there, *gather); !lit) return lit.error();
  if (auto settled = gather->iterate(400); !settled) return settled.error();
  std::vector<Vec4> radiosity(there.source.size());
  if (auto read = gather->radiosity(radiosity); !read) return read.error();
  compareAll(truth, there.pyramid->matrix(), radiosity, there.source, there.at, gathered);
  gathered.patches = there.activePatches();
  gathered.nodes = there.leaves();
  gathered.bytes = gatherBytes(there.pyramid->matrix());

  WorkerPool pool(settings.threads);
  ReadBandwidth bandwidth(pool);
  std::vector<double> reads, gather_ms;
  std::vector<Vec4> light(settings.patches, {1, 1, 1, 0}), irradiance(settings.patches);
  for (int round = 0; round < settings.rounds; ++round) {
    reads.push_back(bandwidth.pass());
    for (Dense& d : dense) {
      const auto relit = medianMs(kRelights, [&] { return d.matrix->relight(light, irradiance); });
      if (!relit) return relit.error();
      d.relight.push_back(*relit);
    }
    const auto step = medianMs(kSteps, [&] { return gather->iterate(1); });
    if (!step) return step.error();
    gather_ms.push_back(*step);
  }
  for (int round = 0; round < settings.rounds; ++round)
    for (Dense& d : dense) {
      const uint32_t first =
          static_cast<uint32_t>(round) * (patches - d.block) / static_cast<uint32_t>(settings.rounds);
      const auto swapped = swapMs(d, first);
      if (!swapped) return swapped.error();
      d.update.push_back(*swapped);
    }
  const auto tiles = tileSwapMs(world, there, settings.threads, 4 * settings.rounds);
  if (!tiles) return tiles.error();
  MethodsThere result;
  result.bytes_per_s = quantile(reads, 0.5);
  const auto setMs = [&](MethodCost& cost, const std::vector<double>& ms) {
    std::vector<double> over_seed;
    for (size_t round = 0; round < ms.size(); ++round) over_seed.push_back(ms[round] / dense.front().relight[round]);
    cost.over_seed = quantile(over_seed, 0.5);
    cost.relight_ms = quantile(ms, 0.5);
    cost.relight_spread_ms = (quantile(ms, 0.75) - quantile(ms, 0.25)) / 2;
  };
  for (Dense& d : dense) {
    setMs(d.cost, d.relight);
    d.cost.update_ms = quantile(d.update, 0.5);
    result.methods.push_back(d.cost);
  }
  setMs(gathered, gather_ms);
  gathered.update_ms = *tiles;
  result.methods.push_back(gathered);
  return result;
}

}  // namespace ff::chart
