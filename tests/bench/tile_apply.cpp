#include "tests/bench/tile_apply.h"

#include <unistd.h>

#include <algorithm>

#include "formats/read/whole_world.h"
#include "tests/bench/truth.h"

namespace ff::bench {
namespace {

struct Times {
  std::vector<double> enter_ms, leave_ms, own_entries, tiles_touched;
};

// Every active level-0 tile out and in again. Nothing else depends on a level-0 tile, so any of them may go.
void timeTiles(const formats::WholeWorld& world, std::span<const stream::StripPtr> active, Times& times) {
  runtime::MatrixAssembler assembler(world);
  orExit(assembler.update(active));
  std::vector<stream::StripPtr> without;
  for (size_t t = 0; t < active.size() && active[t]->id.level == 0; ++t) {
    without.assign(active.begin(), active.end());
    without.erase(without.begin() + static_cast<std::ptrdiff_t>(t));
    auto began = Clock::now();
    orExit(assembler.update(without));
    times.leave_ms.push_back(msSince(began));
    began = Clock::now();
    orExit(assembler.update(active));
    times.enter_ms.push_back(msSince(began));
    times.own_entries.push_back(active[t]->row_start.back());
    times.tiles_touched.push_back(static_cast<double>(assembler.change().rows.size()));
  }
}

}  // namespace

void printTileApply(const std::string& world_path, bool quick) {
  const auto folder = std::filesystem::temp_directory_path() / ("ff_tile_apply_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const formats::WholeWorld world = orExit(formats::WholeWorld::open(world_path.empty() ? bakeTown(folder, quick) : world_path));
  constexpr uint32_t kObservers = 9;
  Times times;
  for (uint32_t k = 0; k < kObservers; ++k) {
    const uint64_t patch = world.levels()[0].nodes / (2 * kObservers) * (2 * k + 1);
    const formats::Strip strip = orExit(world.strip(formats::TileId{0, world.tileOf(0, patch)}));
    const formats::Node& node = strip.nodes[patch - strip.first_node];
    const auto streamer = orExit(stream::Streamer::create(world, {.hysteresis = 1.0f}));
    streamer->update(node.centroid + node.normal * (0.5f * world.info().cell_m), {});
    orExit(streamer->settle());
    timeTiles(world, streamer->active(), times);
  }
  std::filesystem::remove_all(folder);
  const size_t tiles = times.enter_ms.size();
  const std::string note =
      "one thread, median of " + std::to_string(tiles) + " level-0 tiles around " + std::to_string(kObservers) +
      " observers of a town of " + std::to_string(world.levels()[0].nodes) + " patches; median " +
      std::to_string(static_cast<int>(median(times.own_entries))) + " entries of its own, rows changed in " +
      std::to_string(static_cast<int>(median(times.tiles_touched))) + " tiles; 95 % below ";
  const auto below = [](const std::vector<double>& sorted) {  // median() has sorted them
    return std::to_string(sorted[sorted.size() * 95 / 100]) + " ms";
  };
  const double enter = median(times.enter_ms), leave = median(times.leave_ms);
  print("update.tile_apply_ms", enter, "ms", 1, note + below(times.enter_ms), "cpu");
  print("update.tile_leave_ms", leave, "ms", 1, note + below(times.leave_ms), "cpu");
}

}  // namespace ff::bench
