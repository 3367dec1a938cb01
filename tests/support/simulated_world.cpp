#include "tests/support/simulated_world.h"

#include <cmath>
#include <random>

#include "formats/codec/chunk.h"
#include "formats/write/encode.h"
#include "formats/write/shard_writer.h"
#include "formats/write/writer.h"

namespace ff::formats {
namespace {

constexpr uint32_t kQuadrants = 4, kTiles = 16, kNodes = 248, kQuanta = 512;
constexpr uint32_t kSky = 200;  // quanta of each row

// A tile's quadrant of the chunk, and its quadrant of that; so do its child tiles lie, in the child that is the first quadrant.
ChunkCell quadrantOf(uint32_t q) { return {static_cast<int32_t>(q & 1), 0, static_cast<int32_t>(q >> 1)}; }

// Flat ground with steps, so that it is seen a little.
Box boundsOf(uint32_t tile, double chunk_m) {
  const ChunkCell a = quadrantOf(tile / kQuadrants), b = quadrantOf(tile % kQuadrants);
  const auto at = [&](size_t axis) { return chunk_m * (0.5 * a[axis] + 0.25 * b[axis]); };
  const auto edge = static_cast<float>(chunk_m / 4);
  const Vec3 lo{static_cast<float>(at(0)), 0, static_cast<float>(at(2))};
  return {lo, lo + Vec3{edge, 1, edge}};
}

Strip stripOf(uint32_t level, uint32_t tile, const Box& bounds, std::mt19937_64& random) {
  Strip strip;
  strip.id = {level, tile};
  const float area = (bounds.hi.x - bounds.lo.x) * (bounds.hi.z - bounds.lo.z) / kNodes;
  std::vector<uint16_t> counts(kTiles * kNodes * kNodes);  // by partner, row, column
  for (uint32_t i = 0; i < kNodes; ++i) {
    Node node;
    node.area_m2 = area;
    const Vec3 size = bounds.hi - bounds.lo;
    node.centroid = bounds.lo + Vec3{size.x * (static_cast<float>(i % 16) + 0.5f) / 16, 0, size.z * (static_cast<float>(i / 16) + 0.5f) / 16};
    node.normal = {0, 1, 0};
    node.albedo = {0.5f, 0.4f, 0.3f};
    node.quanta = kQuanta;
    node.sky = kSky;
    node.sky_fraction = static_cast<float>(kSky) / kQuanta;
    node.sky_direction = {0, 0.7f, 0};
    strip.nodes.push_back(node);
    for (uint32_t k = 0; k < kQuanta - kSky; ++k) {
      // Mostly its own tile, as in streets; else any of the chunk.
      const uint32_t partner = random() % 4 != 0 ? tile : static_cast<uint32_t>(random() % kTiles);
      ++counts[(partner * kNodes + i) * kNodes + static_cast<uint32_t>((i + random() % 64) % kNodes)];
    }
  }
  for (uint32_t e = 0; e < counts.size(); ++e) {
    if (counts[e] == 0) continue;
    const uint32_t partner = e / (kNodes * kNodes);
    if (strip.blocks.empty() || strip.blocks.back().partner_tile != partner) strip.blocks.push_back({partner, 0});
    ++strip.blocks.back().entries;
    strip.rows.push_back(static_cast<uint8_t>(e / kNodes % kNodes));
    strip.columns.push_back(static_cast<uint8_t>(e % kNodes));
    strip.counts.push_back(counts[e]);
  }
  return strip;
}

}  // namespace

Result<void> writeSimulatedWorld(const std::string& path, uint32_t levels) {
  const StoragePtr storage = posixStorage();
  const std::string stem = path.substr(0, path.size() - 4);
  auto rows = ShardWriter::create(storage, stem, kKindRows, 0), index = ShardWriter::create(storage, stem, kKindIndex, 1);
  if (!rows) return rows.error();
  if (!index) return index.error();
  WorldInfo info;
  info.quanta = kQuanta;
  info.rays = info.fewest_rays = 4096;
  info.generator = "simulated_world";
  info.scene = "simulated";
  std::mt19937_64 random(1);
  std::vector<TileName> names;
  for (uint32_t t = 0; t < kTiles; ++t) names.push_back({{0, 0, 0}, t});
  std::vector<LevelRecord> totals(levels);
  std::vector<ChildChunk> below;  // what a record of a level says of its four children
  for (uint32_t level = 0; level < levels; ++level) {
    const bool top = level + 1 == levels;
    const double chunk_m = std::ldexp(1.0, static_cast<int>(level) + kChunkLog);
    // Numbers within one chunk: its record is the same wherever it lies.
    auto parent = std::make_shared<Chunk>();
    parent->level = level + 1;
    parent->first.resize(level + 2);
    Chunk chunk;
    chunk.level = level;
    chunk.parent = parent;
    chunk.first.resize(level + 1);
    ChildChunk self;
    self.counts.resize(level + 1);
    uint64_t entries = 0, bytes = 0;
    for (uint32_t t = 0; t < kTiles; ++t) {
      const Box bounds = boundsOf(t, chunk_m);
      auto strip = encodeStrip(stripOf(level, t, bounds, random), bounds, names);
      if (!strip) return strip.error();
      TileInfo tile = strip->info;
      auto extent = (*rows)->add(strip->bytes, strip->info.strip.raw_bytes);
      if (!extent) return extent.error();
      tile.strip = *extent;
      tile.first_node = t * kNodes;
      if (level > 0) {
        const uint32_t quadrant = t / kQuadrants, within = t % kQuadrants;
        tile.first_child = quadrant * kTiles + within * kQuadrants;
        tile.end_child = tile.first_child + kQuadrants;
      }
      if (!top)
        for (uint32_t i = 0; i < kNodes; ++i) chunk.parent_index.push_back(static_cast<uint8_t>((t % kQuadrants) * (kNodes / 4) + i / 4));
      chunk.tiles.push_back(tile);
      self.bounds.add(bounds);
      entries += tile.entries;
      bytes += tile.strip.stored_bytes;
    }
    if (level > 0)
      for (uint32_t q = 0; q < kQuadrants; ++q) {
        ChildChunk child = below[q];
        child.cell = quadrantOf(q);
        child.bounds = plusCorner(child.bounds, {child.cell[0] * chunk_m / 2, 0, child.cell[2] * chunk_m / 2});
        chunk.children.push_back(child);
        for (uint32_t l = 0; l < level; ++l) self.counts[l] += child.counts[l];
      }
    self.counts[level] = {kTiles, uint64_t{kTiles} * kNodes};
    // The tiles of the four chunks with one parent are the children of different tiles: a record for each.
    const uint64_t chunks = uint64_t{1} << 2 * (levels - 1 - level);
    below.clear();
    uint64_t records = 0;
    for (uint32_t q = 0; q < (top ? 1 : kQuadrants); ++q) {
      for (uint32_t t = 0; t < kTiles && !top; ++t) chunk.tiles[t].parent_tile = q * kQuadrants + t / kQuadrants;
      const std::vector<std::byte> raw = encodeChunk(info, chunk);
      auto stored = compressChunk(raw);
      if (!stored) return stored.error();
      auto extent = (*index)->add(*stored, static_cast<uint32_t>(raw.size()));
      if (!extent) return extent.error();
      self.record = *extent;
      below.push_back(self);
      records += stored->size() * (top ? 1 : chunks / kQuadrants);
    }
    totals[level] = {chunks * kTiles * kNodes, chunks * kTiles, chunks * entries, chunks * bytes + records};
    info.bounds.add(self.bounds);
  }
  for (auto* shard : {&*rows, &*index}) {
    if (auto ok = (*shard)->finish(); !ok) return ok;
    if (auto ok = (*shard)->rename(); !ok) return ok;
  }
  ByteWriter info_bytes, level_bytes, shard_bytes;
  WorldInfoRecord::fields(info_bytes, info);
  for (const LevelRecord& level : totals) LevelRecord::fields(level_bytes, level);
  for (const auto* shard : {&*rows, &*index}) ShardRecord::fields(shard_bytes, (*shard)->record());
  const SectionBytes sections[] = {{kSectionInfo, info_bytes.data()},
                                   {kSectionLevels, level_bytes.data()},
                                   {kSectionShards, shard_bytes.data()},
                                   {kSectionRoot, encodeRoot(below)}};
  return writeWholeFile(*storage, path, encodeManifest(sections));
}

}  // namespace ff::formats
