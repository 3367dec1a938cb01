#include "tools/chart/sweep/block_size.h"

#include <deque>
#include <memory>
#include <numeric>

#include "runtime/clock.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "tools/chart/sweep/comparison.h"
#include "tools/chart/walks.h"

namespace ff::chart {
namespace {

using namespace runtime;
using namespace walks;

// A full matrix through which patches move, first in, first out.
struct Moving {
  std::unique_ptr<BounceMatrix> matrix;
  Placement placement;
  std::deque<uint32_t> inside;
  uint32_t next = 0;

  Moving(std::unique_ptr<BounceMatrix> m, const SceneRows& set) : matrix(std::move(m)), placement(set, matrix->capacity()) {}

  Result<void> enter(uint32_t count) {
    std::vector<uint32_t> patches(count);
    for (uint32_t& p : patches) {
      p = next++ % placement.set().patches();
      inside.push_back(p);
    }
    return matrix->insert(placement.enter(patches));
  }
  Result<void> leave(uint32_t count) {
    std::vector<uint32_t> patches(inside.begin(), inside.begin() + count);
    inside.erase(inside.begin(), inside.begin() + count);
    return matrix->remove(placement.leave(patches));
  }
  // Milliseconds a node, in and out.
  Result<double> swap(uint32_t block) {
    const auto start = Clock::now();
    if (auto left = leave(block); !left) return left.error();
    if (auto entered = enter(block); !entered) return entered.error();
    if (auto done = matrix->advance(matrix->capacity()); !done) return done.error();
    return msSince(start) / block;
  }
};

}  // namespace

Result<Chart> blockSizeChart(uint32_t places, int rounds) {
  const SceneRows set = makeScene({.patches = 2 * places});
  MultibounceSettings settings;
  settings.places = places;
  std::vector<Moving> all;
  std::vector<std::string> names;
  const auto add = [&](const std::string& name, Result<std::unique_ptr<BounceMatrix>> matrix, uint32_t block) -> Result<void> {
    if (!matrix) return matrix.error();
    names.push_back(name);
    all.emplace_back(std::move(*matrix), set);
    for (uint32_t filled = 0; filled < places; filled += block)
      if (auto entered = all.back().enter(std::min(block, places - filled)); !entered) return entered;
    return {};
  };
  if (auto added = add("seed", makeCpuSeed(settings), 1); !added) return added.error();
  if (auto added = add("multibounce fp32", makeCpuMultibounce(settings), kMaxBlock); !added) return added.error();
  settings.storage = Storage::kFloat16;
  if (auto added = add("multibounce fp16", makeCpuMultibounce(settings), kMaxBlock); !added) return added.error();
  settings.storage = Storage::kFloat32;
  settings.luminance = true;
  if (auto added = add("multibounce luminance", makeCpuMultibounce(settings), kMaxBlock); !added) return added.error();

  const uint32_t sizes[] = {1, 2, 4, 8, 16, 32, 64};
  std::vector<std::vector<std::vector<double>>> ms(all.size(), std::vector<std::vector<double>>(std::size(sizes)));
  for (int round = 0; round < rounds; ++round)
    for (size_t b = 0; b < std::size(sizes); ++b)
      for (size_t m = 0; m < all.size(); ++m) {
        if (m == 0 && b > 0) continue;  // the seed's takes one patch at a time
        const auto took = all[m].swap(sizes[b]);
        if (!took) return took.error();
        ms[m][b].push_back(*took);
      }
  Chart chart;
  chart.id = "block-size";
  chart.title = "Updating the dense matrix, by block size";
  chart.note = "A node leaves and another enters, M = " + std::to_string(places) + ": median of " + std::to_string(rounds) +
               " rounds, all matrices in turn. The seed paper's update takes one at a time.";
  chart.x_label = "nodes that enter and leave together";
  chart.y_label = "ms a node";
  chart.log_x = chart.log_y = true;
  for (size_t m = 0; m < all.size(); ++m) {
    Series series;
    series.name = names[m];
    for (size_t b = 0; b < std::size(sizes); ++b)
      if (!ms[m][b].empty()) {
        const Figure f = medianOf(ms[m][b]);
        Series::Point point;
        point.x = sizes[b];
        point.y = f.value;
        point.y_error = f.error;
        series.points.push_back(point);
      }
    chart.series.push_back(std::move(series));
  }
  return chart;
}

}  // namespace ff::chart
