// ff_bench_soak: half an hour of a game in a few minutes, by one to three observers who walk, drive, fly and teleport, while reads fail, bring damaged bytes and
// stop for seconds. Then the faults end: the state has to be, to the bit, that of a fresh start at that place, and memory may not have grown. Prints JSON lines.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstring>
#include <fstream>
#include <random>

#include "runtime/updater.h"
#include "stream/file_source.h"
#include "tests/bench/faulty_source.h"
#include "tests/bench/truth.h"

namespace {

using namespace ff;
using namespace ff::bench;

constexpr int kFramesASecond = 60;

struct Options {
  std::string world;
  uint64_t patches = 60000;
  uint32_t rays = 128;
  double minutes = 30;
  uint64_t seed = 1;
  float height_m = 1.6f;
};

uint64_t residentBytes() {
  std::ifstream in("/proc/self/statm");
  uint64_t pages = 0;
  in >> pages >> pages;
  return pages * static_cast<uint64_t>(sysconf(_SC_PAGESIZE));
}

// Everybody goes at some speed for some seconds, then turns; now and then somebody is elsewhere, comes or leaves.
class Party {
 public:
  Party(const Box& bounds, float y, uint64_t seed) : lo_(bounds.lo), span_(bounds.hi - bounds.lo), y_(y), random_(seed) { all_.push_back(newcomer()); }
  std::span<const stream::Observer> frame() {
    if (draw() < 1.0f / (20 * kFramesASecond)) {  // every 20 s
      if (all_.size() < 3 && draw() < 0.5f)
        all_.push_back(newcomer());
      else if (all_.size() > 1)
        all_.pop_back();
    }
    for (stream::Observer& one : all_) {
      if (draw() < 1.0f / (15 * kFramesASecond)) one = newcomer();
      if (draw() < 1.0f / (3 * kFramesASecond)) one.velocity = newVelocity();
      const Vec3 next = one.at + one.velocity / kFramesASecond;
      const bool inside = next.x > lo_.x && next.z > lo_.z && next.x < lo_.x + span_.x && next.z < lo_.z + span_.z;
      if (inside)
        one.at = next;
      else
        one.velocity = newVelocity();
    }
    return all_;
  }

  // Nothing is wanted ahead.
  std::span<const stream::Observer> standing() {
    for (stream::Observer& one : all_) one.velocity = {};
    return all_;
  }

 private:
  float draw() { return static_cast<float>(random_() >> 40) / 16777216.0f; }
  Vec3 newVelocity() {
    constexpr float kSpeeds[] = {0, 1.5f, 5, 15, 30, 80};
    const float speed = kSpeeds[random_() % std::size(kSpeeds)], angle = 6.2831853f * draw();
    return {speed * std::cos(angle), 0, speed * std::sin(angle)};
  }
  stream::Observer newcomer() {
    const float x = draw(), z = draw();
    return {{lo_.x + span_.x * x, y_, lo_.z + span_.z * z}, newVelocity()};
  }
  const Vec3 lo_, span_;
  const float y_;
  std::mt19937_64 random_;
  std::vector<stream::Observer> all_;
};

struct Game {
  Game(const formats::World& world, std::unique_ptr<stream::TileSource> source)
      : streamer(orExit(stream::Streamer::create(world, settingsFor(world), std::move(source)))),
        solver(runtime::makeCpuGather()),
        updater(world, *streamer, *solver, runtime::FarLight::kPyramid, true, {.frames = 8}) {
    runtime::Sky sky;
    sky.l0 = {1.1f, 1.4f, 1.9f};
    orExit(updater.setSky(sky));
  }
  static stream::StreamSettings settingsFor(const formats::World& world) {
    stream::StreamSettings settings;
    settings.radius_m *= world.info().cell_m;
    settings.hysteresis = 1;     // what is active is a function of where observers are
    settings.retry_seconds = 0.2f;  // an hour passes in minutes
    settings.background = true;
    return settings;
  }
  // All there, by node: rows, light that arrives, and what twenty steps from darkness come to.
  std::map<std::pair<uint32_t, uint64_t>, std::vector<float>> state(const stream::Observers& at) {
    orExit(updater.frame(at, 1));
    orExit(streamer->settle());
    updater.awaitCut();
    orExit(updater.frame(at, 1));
    solver->ease(0);
    const runtime::LocalMatrix& m = updater.matrix();
    std::vector<Vec4> light(m.slots());
    orExit(solver->setRadiosity(light));
    orExit(solver->iterate(20));
    orExit(solver->radiosity(light));
    std::map<std::pair<uint32_t, uint64_t>, std::vector<float>> state;
    for (const runtime::SlotRange& range : m.tiles)
      for (uint32_t i = 0; i < range.nodes; ++i) {
        const uint32_t slot = range.first_slot + i;
        const Vec4 b = light[slot], s = updater.source()[slot];
        state[{range.id.level, range.first_node + i}] = {b.x, b.y, b.z, s.x, s.y, s.z, static_cast<float>(m.leaf[slot]), static_cast<float>(m.row(slot).size())};
      }
    return state;
  }
  std::unique_ptr<stream::Streamer> streamer;
  std::unique_ptr<runtime::Solver> solver;
  runtime::Updater updater;
};

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{"Half an hour of a game, with faults, in minutes: the state afterwards against a fresh start, and how memory grows. One JSON object a line.", "ff_bench_soak"};
  bool quick = false;
  app.add_option("--world", options.world, "a baked world; without it a town is baked");
  app.add_option("--patches", options.patches, "of the town that is baked: 60000, 60k")->transform(CLI::AsSizeValue(true))->capture_default_str();
  app.add_option("--rays", options.rays, "a patch, of the town that is baked")->capture_default_str();
  app.add_option("--minutes", options.minutes, "of the game, 60 frames a second")->check(CLI::Range(0.1, 1e5))->capture_default_str();
  app.add_option("--seed", options.seed, "of ways and faults")->capture_default_str();
  app.add_option("--height", options.height_m, "of the eyes, m")->capture_default_str();
  app.add_flag("--quick", quick, "two minutes of the game, a smaller town");
  CLI11_PARSE(app, argc, argv);
  if (quick) options.minutes = std::min(options.minutes, 2.0);
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_soak_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const std::string path = options.world.empty() ? bakeTown(folder, quick, options.patches, options.rays) : options.world;
  const formats::World world = orExit(formats::World::open(path));
  Faults faults;
  Game game(world, std::make_unique<FaultySource>(stream::makeFileSource(world), faults, options.seed));
  Party party(world.info().bounds, options.height_m, options.seed);
  faults.on = true;
  const auto frames = static_cast<uint64_t>(options.minutes * 60 * kFramesASecond);
  uint64_t first_half = 0, second_half = 0, worst_light = 0;
  std::vector<Vec4> light;
  stream::Observers at;
  for (uint64_t f = 0; f < frames; ++f) {
    const uint64_t second = f / kFramesASecond;
    faults.outage = second % 60 >= 55;  // five seconds a minute
    at = stream::Observers(party.frame());
    orExit(game.updater.frame(at, 2));
    light.resize(game.updater.matrix().slots());
    orExit(game.updater.radiosity(light));
    for (const Vec4& b : light) worst_light += !(std::isfinite(b.x) && b.x >= 0 && std::isfinite(b.y) && b.y >= 0 && std::isfinite(b.z) && b.z >= 0);
    if (f % kFramesASecond == 0) {
      uint64_t& most = f < frames / 2 ? first_half : second_half;
      most = std::max(most, residentBytes());
    }
  }
  faults.on = faults.outage = false;
  at = stream::Observers(party.standing());
  for (int tries = 0; tries < 400; ++tries) {  // what failed is tried again every so often
    orExit(game.updater.frame(at, 1));
    orExit(game.streamer->settle());
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  const uint64_t failed = game.streamer->stats().failed, read = game.streamer->stats().strips_read;
  const auto ends = game.state(at);
  Game fresh(world, nullptr);
  const auto expected = fresh.state(at);
  uint64_t differ = 0;
  for (const auto& [node, values] : expected) {
    const auto found = ends.find(node);
    differ += found == ends.end() || std::memcmp(found->second.data(), values.data(), values.size() * sizeof(float)) != 0;
  }
  differ += ends.size() > expected.size() ? ends.size() - expected.size() : 0;
  const std::string note = std::to_string(frames) + " frames, 1 to 3 observers, " + std::to_string(read) + " strips read, " + std::to_string(faults.errors) + " errors and " +
                           std::to_string(faults.damaged) + " damaged strips put in, " + std::to_string(failed) + " strips given up for a while";
  print("stream.soak_different_nodes", static_cast<double>(differ), "nodes", 0, note + "; of " + std::to_string(expected.size()) + " in the cut at the end, against a fresh start there, to the bit");
  print("stream.soak_unsound_light", static_cast<double>(worst_light), "slots", 0, note + "; not finite or below 0, over all frames");
  print("stream.soak_growth_bytes", static_cast<double>(second_half) - static_cast<double>(first_half), "B", 0,
        note + "; most resident in the second half, " + std::to_string(second_half) + ", over that in the first");
  std::filesystem::remove_all(folder);
  return 0;
}
