// ff_bench_remote: a world behind a web server on this machine that takes its time for each answer, as a network does: how long after a teleport all is
// there, with how many requests and bytes, with pieces in memory and with an empty folder for them; and how long from nothing to the first place. Beside it, in turns, the same where each strip has a read of
// its own. Prints JSON lines.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <random>
#include <set>

#include "formats/storage/cached_storage.h"
#include "formats/storage/http_storage.h"
#include "stream/file_source.h"
#include "stream/streamer.h"
#include "tests/bench/truth.h"
#include "tests/support/web_server.h"

namespace {

using namespace ff;
using namespace ff::bench;

struct Options {
  std::string world;
  uint64_t patches = 60000;
  int teleports = 9, delay_ms = 30;
  float height_m = 1.6f;
  bool quick = false;
};

constexpr int kThreads = 16;  // as many as a remote source has

struct Teleports {
  std::vector<double> ready_ms, opened_ms;
  uint64_t open_requests = 0, open_index_requests = 0;
  uint64_t requests = 0, index_requests = 0, line_bytes = 0, used_bytes = 0, strips = 0, reads = 0;
};

Vec3 placeOf(const Options& options, const Box& bounds, int number) {
  std::mt19937 random(static_cast<uint32_t>(number));
  const auto share = [&] { return 0.1f + 0.8f * static_cast<float>(random() >> 8) / 16777216.0f; };
  const Vec3 size = bounds.hi - bounds.lo;
  const float x = share();
  return {bounds.lo.x + size.x * x, options.height_m, bounds.lo.z + size.z * share()};
}

void fly(const Options& options, formats::WebServer& server, const std::atomic<uint64_t>& index_requests, bool cached, bool shared, const std::string& folder, Teleports& sum) {
  const auto storage = formats::cachedStorage(formats::httpStorage(), {.folder = cached ? folder + "/cache" : ""});
  const uint64_t requests_before = server.requests, of_index_before = index_requests;
  const auto opened = Clock::now();
  const auto world = orExit(formats::World::open(server.address("/" + formats::fileNameOf(options.world)), storage));
  stream::StreamSettings settings;
  settings.radius_m *= world.info().cell_m;
  const auto streamer = orExit(stream::Streamer::create(world, settings, shared ? stream::makeFileSource(world) : stream::makeThreadSource(world, kThreads, {})));
  std::set<formats::TileId> seen;
  for (int number = 0; number <= options.teleports; ++number) {  // the first belongs to opening
    const uint64_t requests = server.requests, of_index = index_requests, line_bytes = server.body_bytes;
    const stream::StreamStats before = streamer->stats();
    const auto began = Clock::now();
    streamer->update(placeOf(options, world.info().bounds, number), {});
    orExit(streamer->settle());
    const double ready_ms = msSince(began);
    uint64_t used_bytes = 0;
    for (const stream::StripPtr& strip : streamer->active())
      if (seen.insert(strip->id).second) used_bytes += strip->tile.info().strip.stored_bytes;
    if (number == 0) {
      sum.opened_ms.push_back(msSince(opened));
      sum.open_requests += server.requests - requests_before;
      sum.open_index_requests += index_requests - of_index_before;
      continue;
    }
    const stream::StreamStats after = streamer->stats();
    sum.ready_ms.push_back(ready_ms);
    sum.requests += server.requests - requests;
    sum.index_requests += index_requests - of_index;
    sum.line_bytes += server.body_bytes - line_bytes;
    sum.used_bytes += used_bytes;
    sum.strips += after.strips_read - before.strips_read;
    sum.reads += after.reads - before.reads;
    if (after.failed > 0) orExit(Result<void>(Error{ErrorCode::kIo, options.world, "", streamer->lastFailure(), ""}));
  }
  std::filesystem::remove_all(folder + "/cache");
}

void report(const std::string& name, Teleports& ours, Teleports& alone) {
  const auto each = [](uint64_t of, const Teleports& all) { return static_cast<double>(of) / static_cast<double>(all.ready_ms.size()); };
  const std::string alone_note = "; limit: each strip by a read of its own, in turns", note = name + ", " + std::to_string(ours.ready_ms.size()) + " teleports" + alone_note;
  const auto flights = static_cast<double>(ours.opened_ms.size());
  print("remote.open_ms", median(ours.opened_ms), "ms", median(alone.opened_ms), name + alone_note + "; until the world is open and all of the first place is there");
  print("remote.open_requests", static_cast<double>(ours.open_requests) / flights, "requests", static_cast<double>(alone.open_requests) / flights,
        name + alone_note + "; likewise, of these " + std::to_string(static_cast<int>(static_cast<double>(ours.open_index_requests) / flights)) + " of the index");
  const double ours_ms = median(ours.ready_ms), alone_ms = median(alone.ready_ms);
  print("remote.ready_ms", ours_ms, "ms", alone_ms, note + "; until all is there, median");
  print("remote.requests", each(ours.requests, ours), "requests", each(alone.requests, alone), note + "; a teleport, of these " + std::to_string(static_cast<int>(each(ours.index_requests, ours))) + " of the index");
  print("remote.strips_a_read", static_cast<double>(ours.strips) / static_cast<double>(ours.reads), "strips", 1, note);
  print("remote.read_amplification", static_cast<double>(ours.line_bytes) / static_cast<double>(ours.used_bytes), "ratio",
        static_cast<double>(alone.line_bytes) / static_cast<double>(alone.used_bytes), note + "; bytes on the line over those of strips that became active");
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{"Teleports through a world behind a web server that takes its time: until all is there, requests, bytes. One JSON object a line.", "ff_bench_remote"};
  app.add_option("--world", options.world, "a baked world; without it a town is baked");
  app.add_flag("--quick", options.quick, "a smaller town, fewer teleports");
  app.add_option("--patches", options.patches, "of the town that is baked: 60000, 60k, 1M")->transform(CLI::AsSizeValue(true))->capture_default_str();
  app.add_option("--teleports", options.teleports)->check(CLI::Range(1, 1000))->capture_default_str();
  app.add_option("--delay", options.delay_ms, "ms that every answer takes")->check(CLI::Range(0, 10000))->capture_default_str();
  app.add_option("--height", options.height_m, "of the eyes, m, in the world's coordinates")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  if (options.quick) options.teleports = std::min(options.teleports, 3);
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_remote_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  if (options.world.empty()) options.world = bakeTown(folder, options.quick, options.patches, 512);
  formats::WebServer server;
  server.addFolder(formats::folderOf(options.world));
  std::atomic<uint64_t> index_requests = 0;
  server.spoil = [&](const formats::WebServer::Request& request, formats::WebServer::Reply& reply) {
    index_requests += request.path.find(".index.") != std::string::npos;
    reply.delay = std::chrono::milliseconds(options.delay_ms);
  };
  for (const bool cached : {true, false}) {
    Teleports ours, alone;
    for (int turn = 0; turn < 2; ++turn) {
      fly(options, server, index_requests, cached, false, folder.string(), alone);
      fly(options, server, index_requests, cached, true, folder.string(), ours);
    }
    report(std::string(cached ? "an empty cache" : "no folder for a cache") + ", answers " + std::to_string(options.delay_ms) + " ms late", ours, alone);
  }
  std::filesystem::remove_all(folder);
  return 0;
}
