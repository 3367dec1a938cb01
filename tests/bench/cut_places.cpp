#include "tests/bench/cut_places.h"

#include <algorithm>
#include <array>

#include "formats/read/whole_world.h"
#include "tools/chart/neighbourhood.h"

namespace ff::bench {
namespace {

using namespace ff::runtime;

constexpr float kEyeHeight_m = 1.6f;
constexpr std::array kDistances_m{6, 12, 24, 48, 96};
// Of its sky, a floor in a street sees between these, one in a room less; roofs and fields see more. (Cosine-weighted.)
constexpr float kRoomSky = 0.02f, kStreetSky = 0.6f;
constexpr float kStep_m = 0.5f;  // a frame, at 30 m/s and 60 frames a second

std::unique_ptr<stream::Streamer> streamerOf(const formats::WholeWorld& world, const CutSettings& s, float hysteresis) {
  return orExit(stream::Streamer::create(
      world, {.radius_m = s.radius_m, .growth = s.growth, .hysteresis = hysteresis, .max_level0_nodes = s.max_patches}));
}

std::string describe(const formats::WholeWorld& world, const CutSettings& s) {
  return std::to_string(world.levels()[0].nodes) + " patches, at most " + std::to_string(s.max_patches) + " active, r_0 " +
         std::to_string(s.radius_m) + " m";
}

struct Walk {
  const char* name;
  std::vector<Vec3> eyes;
};

// Around the middle of the town, from an eye in a street.
std::vector<Walk> walksFrom(const formats::WholeWorld& world, Vec3 eye) {
  const Box& box = world.info().bounds;
  const float half = 0.4f * (box.hi.x - box.lo.x);
  constexpr int kSteps = 240;  // 4 s
  std::vector<Walk> walks{{"line", {}}, {"there and back", {}}, {"circle", {}}};
  const int line = std::min(kSteps * 4, static_cast<int>(2 * half / kStep_m));
  for (int i = 0; i < line; ++i) walks[0].eyes.push_back({eye.x + kStep_m * static_cast<float>(i - line / 2), eye.y, eye.z});
  for (int i = 0; i < kSteps; ++i) {
    const int there = i % 40 < 20 ? i % 40 : 40 - i % 40;  // 10 m
    walks[1].eyes.push_back({eye.x, eye.y, eye.z + kStep_m * static_cast<float>(there)});
    const float angle = static_cast<float>(i) * kStep_m / 15;  // of a radius of 15 m
    walks[2].eyes.push_back({eye.x + 15 * std::cos(angle), eye.y, eye.z + 15 * std::sin(angle)});
  }
  return walks;
}

}  // namespace

std::vector<Vec4> convergedRadiosity(const LocalMatrix& matrix, std::span<const Vec4> source, double* iteration_ms) {
  constexpr int kIterations = 200;  // albedo <= 0.9 and half of the light leaves for the sky: converged to fp32
  const auto solver = makeCpuGather();
  orExit(chart::lightUp(matrix, source, *solver));
  orExit(solver->iterate(kIterations));
  if (iteration_ms) *iteration_ms = solver->lastMs() / kIterations;
  std::vector<Vec4> radiosity(matrix.slots());
  orExit(solver->radiosity(radiosity));
  return radiosity;
}

std::vector<Vec3> standingEyes(const Truth& truth, int count) {
  std::vector<std::pair<uint64_t, Vec3>> floors[2];  // streets, rooms
  for (const formats::Strip& strip : truth.patches)
    for (const formats::Node& node : strip.nodes) {
      if (node.normal.y < 0.9f || node.sky_fraction > kStreetSky) continue;
      uint64_t order = 0x9e3779b97f4a7c15ull;  // mixed from where it lies
      for (int a = 0; a < 3; ++a)
        order = (order ^ static_cast<uint64_t>(std::llround(static_cast<double>(node.centroid[a]) * 16))) * 0xff51afd7ed558ccdull, order ^= order >> 29;
      floors[node.sky_fraction < kRoomSky].emplace_back(order, node.centroid + Vec3{0, kEyeHeight_m, 0});
    }
  std::vector<Vec3> eyes;
  for (auto& kind : floors) {
    std::sort(kind.begin(), kind.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    for (size_t k = 0; k < std::min(kind.size(), static_cast<size_t>(count) / 2); ++k) eyes.push_back(kind[k].second);
  }
  return eyes;
}

void printFixedDistances(const formats::WholeWorld& world, const Truth& truth, const CutSettings& settings, int count) {
  struct Ring {
    uint64_t patches = 0, full = 0;
    std::vector<double> errors;
  };
  std::array<Ring, kDistances_m.size()> rings;
  std::vector<double> slots, tiles, level0, entries;
  const std::vector<Vec3> eyes = standingEyes(truth, count);
  for (const Vec3 eye : eyes) {
    const auto streamer = streamerOf(world, settings, 1);
    streamer->update(eye, {});
    orExit(streamer->settle());
    const LocalMatrix matrix = orExit(buildLocalMatrix(world, streamer->active()));
    const std::vector<Vec4> source = sourceOf(truth, world, matrix, streamer->active()), radiosity = convergedRadiosity(matrix, source);
    slots.push_back(matrix.slots());
    tiles.push_back(static_cast<double>(matrix.tiles.size()));
    entries.push_back(static_cast<double>(matrix.used_entries));
    level0.push_back(0);
    for (const SlotRange& range : matrix.tiles) level0.back() += range.id.level == 0 ? range.nodes : 0;
    for (const formats::Strip& strip : truth.patches) {
      const formats::TileRef tile = world.ref(strip.id);
      for (uint32_t i = 0; i < strip.nodes.size(); ++i) {
        const formats::Node& node = strip.nodes[i];
        const float away = length(node.centroid - eye);
        if (away > static_cast<float>(kDistances_m.back())) continue;
        const uint32_t patch = formats::wholeNumber(strip.first_node + i), slot = slotFor(matrix.tiles, tile, i);
        // What its surface reflects, as its node in the cut is lit: 1 / albedo of reflected radiosity.
        const Vec4 b = radiosity[slot], rho = matrix.albedo[slot];
        const float shown[3] = {b.x, b.y, b.z}, albedo[3] = {rho.x, rho.y, rho.z};
        double off = 0, all = 0;
        for (int c = 0; c < 3; ++c) {
          const double full = truth.radiosity[3 * size_t{patch} + static_cast<size_t>(c)];
          const double now = albedo[c] > 0 ? static_cast<double>(shown[c] / albedo[c] * node.albedo[c]) : 0;
          off += (now - full) * (now - full);
          all += full * full;
        }
        if (std::sqrt(all / 3) < 1e-4 * truth.rms) continue;  // dark: no relative error
        for (size_t d = 0; d < kDistances_m.size(); ++d) {
          if (away > static_cast<float>(kDistances_m[d])) continue;
          ++rings[d].patches;
          rings[d].full += matrix.slotOf(0, patch) != kNoSlot;
          rings[d].errors.push_back(std::sqrt(off / all));
        }
      }
    }
  }
  const std::string name = describe(world, settings) + "; " + std::to_string(eyes.size()) + " eyes, half in streets, half in rooms";
  for (size_t d = 0; d < kDistances_m.size(); ++d) {
    const std::string within = std::to_string(kDistances_m[d]) + "m";
    const auto patches = static_cast<double>(rings[d].patches);
    print("cut.full_resolution_" + within, static_cast<double>(rings[d].full) / patches, "share", 1,
          name + "; " + std::to_string(rings[d].patches) + " patches");
    std::vector<double>& errors = rings[d].errors;
    const double middle = median(errors);
    print("cut.median_error_" + within, middle, "relative", std::nan(""),
          name + "; of reflected radiosity, patch by patch, shown by its node in the cut; 90 % of patches below " +
              std::to_string(100 * errors[errors.size() * 9 / 10]) + " %");
  }
  const auto printAll = [&](const char* metric, std::vector<double> values, double limit) {
    const double middle = median(values);
    print(metric, middle, metric + 4, limit, name + "; median, " + std::to_string(values.front()) + " to " + std::to_string(values.back()));
  };
  printAll("cut.slots", slots, kMaxSlots);
  printAll("cut.patches", level0, settings.max_patches);
  printAll("cut.tiles", tiles, std::nan(""));
  printAll("cut.entries", entries, std::nan(""));
}

void printCutChanges(const formats::WholeWorld& world, const Truth& truth, const CutSettings& settings) {
  const std::vector<Vec3> eyes = standingEyes(truth, 2);
  for (const Walk& walk : walksFrom(world, eyes.front())) {
    const auto streamer = streamerOf(world, settings, stream::StreamSettings{}.hysteresis);
    MatrixAssembler assembler(world);
    const auto solver = makeCpuGather(1);
    std::vector<double> ms, entered;
    int renumbered = 0;
    uint32_t max_slots = 0;
    for (size_t i = 0; i < walk.eyes.size(); ++i) {
      streamer->update(walk.eyes[i], {});
      orExit(streamer->settle());
      const double began = threadMs();
      orExit(assembler.update(streamer->active()));
      if (assembler.change().any) orExit(solver->update(assembler.matrix(), assembler.change()));
      const double took = threadMs() - began;
      if (i == 0 || !assembler.change().any) continue;
      ms.push_back(took);
      entered.push_back(static_cast<double>(assembler.change().entered.size() + assembler.change().left.size()));
      renumbered += assembler.change().renumbered;
      max_slots = std::max(max_slots, assembler.matrix().slots());
    }
    if (ms.empty()) continue;
    const double worst = *std::max_element(ms.begin(), ms.end()), most = *std::max_element(entered.begin(), entered.end());
    print("cut.change_ms", worst, "ms", 10,
          describe(world, settings) + "; " + walk.name + " at 30 m/s, every tile there at once: worst of " + std::to_string(ms.size()) +
              " changes in " + std::to_string(walk.eyes.size()) + " frames, median " + std::to_string(median(ms)) +
              " ms of the frame's thread (matrix and gather's tables); at most " + std::to_string(static_cast<int>(most)) +
              " tiles enter and leave at once; slots numbered anew " + std::to_string(renumbered) + " times, highest slot " +
              std::to_string(max_slots) + ", pages " + std::to_string(assembler.matrix().pages->pages().size()),
          "cpu");
  }
}

}  // namespace ff::bench
