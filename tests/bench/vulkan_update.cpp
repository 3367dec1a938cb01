#include "tests/bench/vulkan_update.h"

#include <unistd.h>

#include <algorithm>

#include "formats/read/whole_world.h"
#include "runtime/cut/matrix_assembler.h"
#include "runtime/dense/vk_multibounce.h"
#include "runtime/dense/vk_seed.h"
#include "runtime/gather/vk_recorder.h"
#include "tests/bench/truth.h"
#include "tools/chart/walks.h"

namespace ff::bench {
namespace {

using namespace ff::runtime;
using namespace ff::walks;

// A node leaves and enters: ms by the device's clock, in blocks of `block`.
double msPerNode(BounceMatrix& matrix, Placement& at, uint32_t block, uint32_t first, int repeats) {
  std::vector<double> ms;
  for (int repeat = 0; repeat < repeats; ++repeat) {
    std::vector<uint32_t> some(block);
    for (uint32_t i = 0; i < block; ++i) some[i] = first + static_cast<uint32_t>(repeat) * block + i;
    orExit(matrix.insert(at.enter(some)));
    double both = matrix.stats().last_update_ms;
    orExit(matrix.remove(at.leave(some)));
    both += matrix.stats().last_update_ms;
    if (repeat > 0) ms.push_back(both / block);  // the first compiles
  }
  return median(ms);
}

void printBlocks(const std::shared_ptr<VkContext>& context, bool quick) {
  const uint32_t places = isSoftwareDevice(*context) ? (quick ? 256 : 512) : 4096;
  const int repeats = quick ? 4 : 12;
  const SceneRows scene = makeScene({.patches = 2 * places});
  const auto seed = orExit(makeVulkanSeed(context, {.places = places}));
  Placement seed_at(scene, places);
  // Filled but for a block, so that its passes go over all of the matrix.
  std::vector<uint32_t> there(places - kMaxBlock);
  for (uint32_t i = 0; i < there.size(); ++i) there[i] = i;
  const auto fill = [&](BounceMatrix& matrix, Placement& at) {
    for (size_t i = 0; i < there.size(); i += kMaxBlock)
      orExit(matrix.insert(at.enter(std::span(there).subspan(i, std::min<size_t>(kMaxBlock, there.size() - i)))));
  };
  fill(*seed, seed_at);
  const double single_ms = msPerNode(*seed, seed_at, 1, places, 4 * repeats);
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    const auto matrix = orExit(makeVulkanMultibounce(context, {.places = places, .storage = storage}));
    Placement at(scene, places);
    fill(*matrix, at);
    const double block_ms = msPerNode(*matrix, at, kMaxBlock, places, std::min<int>(repeats, static_cast<int>(places / kMaxBlock)));
    print("update.block_speedup_over_single", single_ms / block_ms, "ratio", 10,
          std::string(matrix->name()) + ", blocks of " + std::to_string(kMaxBlock) + " enter and leave, M = " +
              std::to_string(places) + ": " + std::to_string(block_ms) + " ms a node against the seed's " +
              std::to_string(single_ms) + ", device timestamps, medians; the limit is the target",
          "vulkan");
  }
}

void printTile(const std::shared_ptr<VkContext>& context, const std::string& world_path, bool quick) {
  const auto folder = std::filesystem::temp_directory_path() / ("ff_vulkan_update_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const formats::WholeWorld world = orExit(formats::WholeWorld::open(world_path.empty() ? bakeTown(folder, quick) : world_path));
  const auto recorder = orExit(makeVulkanRecorder(context, gatherRoomFor(world, slotsFor(stream::StreamSettings().max_nodes))));
  const uint64_t patch = world.levels()[0].nodes / 2;
  const formats::Strip strip = orExit(world.strip(formats::TileId{0, world.tileOf(0, patch)}));
  const formats::Node& node = strip.nodes[patch - strip.first_node];
  const auto streamer = orExit(stream::Streamer::create(world, {.hysteresis = 1.0f}));
  streamer->update(node.centroid + node.normal * (0.5f * world.info().cell_m), {});
  orExit(streamer->settle());
  const auto all = streamer->active();
  MatrixAssembler assembler(world);
  const auto apply = [&](std::span<const stream::StripPtr> active) {
    orExit(assembler.update(active));
    orExit(recorder->update(assembler.matrix(), assembler.change()));
    orExit(recorder->iterate(1));
    return recorder->lastChangeMs();
  };
  apply(all);
  const uint64_t everything = recorder->uploaded().rows;
  std::vector<double> ms, bytes, entries;
  const size_t most = quick ? 8 : 40;
  for (size_t t = 0; t < all.size() && all[t]->id.level == 0 && ms.size() < most; ++t) {
    std::vector<stream::StripPtr> without(all.begin(), all.end());
    without.erase(without.begin() + static_cast<std::ptrdiff_t>(t));
    apply(without);
    const uint64_t before = recorder->uploaded().rows;
    ms.push_back(apply(all));
    bytes.push_back(static_cast<double>(recorder->uploaded().rows - before));
    entries.push_back(all[t]->row_start.back());
  }
  std::filesystem::remove_all(folder);
  const size_t tiles = ms.size();
  print("update.tile_apply_ms", median(ms), "ms", 1,
        std::string(recorder->name()) + ": uploads, resolving, warm start; device timestamps, median of " +
            std::to_string(tiles) + " level-0 tiles of " + std::to_string(static_cast<int>(median(entries))) + " entries; " +
            std::to_string(static_cast<int>(median(bytes) / 1024)) + " KiB cross the bus, " +
            std::to_string(everything >> 10) + " KiB for the whole cut of " +
            std::to_string(assembler.matrix().used_entries) + " entries",
        "vulkan");
}

}  // namespace

void printVulkanUpdates(const std::string& world_path, bool quick) {
  auto context = openVulkan();
  if (!context) {
    std::cerr << "ff_bench_update: Vulkan is left out: " << context.error().line() << "\n";
    return;
  }
  printTile(*context, world_path, quick);
  printBlocks(*context, quick);
}

}  // namespace ff::bench
