// Small random worlds that keep every rule of the format, for tests of reader, writer and tools.
#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"
#include "formats/storage/storage.h"

namespace ff::formats {

struct RandomWorldSettings {
  uint32_t level0_tiles = 5;
  uint32_t max_tile_nodes = kTileNodes;  // tiles have 1..this many nodes
  uint32_t levels = 3;
  uint32_t quanta = 64;
  bool geometry = true;
  uint64_t shard_bytes = uint64_t{256} << 20;
  uint64_t seed = 1;
};

struct RandomWorld {
  WorldInfo info;
  std::vector<std::vector<Strip>> strips;  // by level, tile
  std::vector<std::vector<Box>> bounds;
  std::vector<std::vector<uint32_t>> parents;
  std::vector<TileGeometry> geometry;
};

// Names that fit the tree of tiles, by level and tile: four tiles of the coarsest level a chunk, child tiles in two octants by turns.
std::vector<std::vector<TileName>> nameTiles(const RandomWorld& world);

RandomWorld makeRandomWorld(const RandomWorldSettings& settings);
Result<void> writeWorld(const RandomWorld& world, const std::string& path, uint64_t shard_bytes,
                        const StoragePtr& storage = posixStorage(), std::vector<std::string>* warnings = nullptr);
// Path of the first shard of a kind (records.h), of a world whose manifest can be read.
std::string shardOf(const std::string& path, uint32_t kind = 0);

// A fresh folder that is removed at the end of the test.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  std::string file(const std::string& name) const { return path_ + "/" + name; }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

std::vector<std::byte> readFile(const std::string& path);
void writeFile(const std::string& path, std::span<const std::byte> bytes);

}  // namespace ff::formats
