// ff_bench_codec [--quick]: size and decoding speed of strips, on the level-0 rows of a baked voxel town, beside zstd
// alone on the same bytes. Prints one JSON object a line (metric, value, unit, limit, note). One thread.
#include <zstd.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <iostream>
#include <nlohmann/json.hpp>

#include "bake/bake.h"
#include "bake/import/gltf_import.h"
#include "formats/codec/records.h"
#include "formats/read/whole_world.h"
#include "formats/write/writer.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace {

using namespace ff;
using namespace ff::formats;
using Clock = std::chrono::steady_clock;

constexpr int kRepeats = 7;

int failed(const Error& error) {
  std::cerr << "ff_bench_codec: " << error.line() << "\n";
  return static_cast<int>(error.code);
}

void print(const char* metric, double value, const char* unit, nlohmann::json limit, const std::string& note) {
  std::cout << nlohmann::json{{"metric", metric},
                              {"value", value},
                              {"unit", unit},
                              {"limit", std::move(limit)},
                              {"note", note}}
                   .dump()
            << std::endl;
}

// Seconds of the fastest run: the others measure what else the machine does.
double fastest(const std::function<void()>& work) {
  double best = 1e30;
  for (int i = 0; i < kRepeats; ++i) {
    const auto begin = Clock::now();
    work();
    best = std::min(best, std::chrono::duration<double>(Clock::now() - begin).count());
  }
  return best;
}

int measure(const WholeWorld& world, const std::string& scene) {
  const auto tiles = world.tiles(0);
  std::vector<std::vector<std::byte>> stored;
  std::vector<Strip> strips;
  std::vector<TileRef> refs;
  std::vector<TileName> names;
  for (const TileInfo& t : tiles) {
    refs.push_back(world.ref(t.id));
    names.push_back(refs.back().name());
  }
  double entries = 0, payload = 0, raw = 0;
  for (const TileInfo& t : tiles) {
    stored.emplace_back(t.strip.stored_bytes);
    if (auto ok = world.readStored(t.strip, stored.back()); !ok) return failed(ok.error());
    auto strip = world.strip(t.id);
    if (!strip) return failed(strip.error());
    strips.push_back(std::move(*strip));
    entries += t.entries;
    payload += t.strip.stored_bytes - static_cast<double>(kStripHeaderBytes);
    raw += t.strip.raw_bytes;
  }
  const LevelInfo& level = world.levels()[0];
  const std::string note = scene + ", " + std::to_string(static_cast<uint64_t>(entries)) + " entries, " +
                           std::to_string(entries / static_cast<double>(level.nodes)).substr(0, 5) + " a row";
  print("codec.bytes_per_entry", static_cast<double>(level.stored_bytes) / entries, "B", nullptr,
        note + "; everything: rows, node records, headers, index");
  print("codec.bytes_per_patch", static_cast<double>(level.stored_bytes) / static_cast<double>(level.nodes), "B", 190, note);

  Strip out;
  const double decode = fastest([&] {
    for (size_t t = 0; t < tiles.size(); ++t)
      if (auto ok = world.decodeStrip(refs[t], stored[t], out); !ok) std::exit(failed(ok.error()));
  });
  std::vector<std::byte> buffer(64u << 20);
  ZSTD_DCtx* context = ZSTD_createDCtx();
  const double bare = fastest([&] {
    for (const auto& s : stored)
      if (ZSTD_isError(ZSTD_decompressDCtx(context, buffer.data(), buffer.size(), s.data() + kStripHeaderBytes,
                                           s.size() - kStripHeaderBytes)))
        std::exit(3);
  });
  ZSTD_freeDCtx(context);
  const double encode = fastest([&] {
    for (size_t t = 0; t < tiles.size(); ++t)
      if (auto e = encodeStrip(strips[t], tiles[t].bounds, names); !e) std::exit(failed(e.error()));
  });
  print("codec.decode_entries_per_s", entries / decode, "1/s", entries / bare,
        note + "; checksum, decompression, decoding and all checks; limit: ZSTD_decompressDCtx alone");
  print("codec.decode_ratio_to_bare_zstd", bare / decode, "1", 1, note);
  print("codec.decode_gb_per_s", raw / decode / 1e9, "GB/s", raw / bare / 1e9, note + "; of decompressed payload");
  print("codec.encode_entries_per_s", entries / encode, "1/s", nullptr, note);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const bool quick = argc > 1 && std::strcmp(argv[1], "--quick") == 0;
  std::string pattern = (std::filesystem::temp_directory_path() / "ff_bench_XXXXXX").string();
  if (::mkdtemp(pattern.data()) == nullptr) return 2;
  const std::string folder = pattern;
  const auto run = [&]() -> int {
    auto town = tools::makeTown({.patches = quick ? 6000u : 20000u});
    if (!town) return failed(town.error());
    if (auto ok = tools::writeGlb(tools::townModel(*town, false), folder + "/town.glb"); !ok) return failed(ok.error());
    auto scene = bake::importGltf(folder + "/town.glb");
    if (!scene) return failed(scene.error());
    bake::BakeSettings settings;
    settings.rays = quick ? 1024 : 4096;
    settings.quanta = 512;
    settings.cell_m = 1;
    if (auto stats = bake::bakeWorld(*scene, settings, folder + "/town.ffm", {}); !stats) return failed(stats.error());
    auto world = WholeWorld::open(folder + "/town.ffm");
    if (!world) return failed(world.error());
    return measure(*world, "voxel town of " + std::to_string(world->levels()[0].nodes) + " patches, " +
                               std::to_string(settings.rays) + " rays, Q = 512");
  };
  const int code = run();
  std::error_code ignored;
  std::filesystem::remove_all(folder, ignored);
  return code;
}
