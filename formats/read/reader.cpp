#include "formats/read/reader.h"

#include <zstd.h>

#include <algorithm>
#include <condition_variable>
#include <map>
#include <mutex>
#include <new>

#include "formats/codec/checksum.h"
#include "formats/codec/geometry.h"
#include "formats/codec/manifest.h"
#include "formats/codec/strip_codec.h"
#include "formats/read/shard.h"
#include "formats/storage/in_parallel.h"

namespace ff::formats {

struct World::State {
  std::string path, folder;
  StoragePtr storage;
  Manifest manifest;
  uint64_t checksum = 0;  // of its bytes
  std::vector<ShardInfo> shards;
  bool all = false;  // will be read
  mutable std::mutex mutex;  // guards what follows; not held while anything is opened or read
  mutable std::vector<std::unique_ptr<StoredFile>> files;  // of `shards`; null: not opened yet
  mutable std::vector<bool> opening;                       // by somebody
  mutable std::condition_variable opened;                  // or not: nobody does any more

  Result<const StoredFile*> file(uint32_t shard, const ReadOptions& options = {}) const;
  // Whether what the index names is there, as the manifest has it.
  bool holds(uint32_t kind, const Extent& e) const {
    return e.shard < shards.size() && shards[e.shard].kind == kind && e.offset >= kShardHeaderBytes && e.offset <= shards[e.shard].bytes &&
           e.stored_bytes <= shards[e.shard].bytes - e.offset;
  }
  std::string pathOf(uint32_t shard) const { return folder + shards[shard].name; }
  // What was read there is damaged: copies of it go, so that the next read may bring what was written.
  void forget(const Extent& e) const {
    if (auto from = file(e.shard)) (*from)->forget(e.offset, e.stored_bytes);
  }
};

namespace {

constexpr const char* kRemedy = "restore the world's files from one copy, or bake again";

Error inFile(Error e, const std::string& path) {
  if (e.file.empty()) e.file = path;
  return e;
}

}  // namespace

Result<World> World::open(const std::string& path, const StoragePtr& given) try {
  const StoragePtr storage = given ? given : storageFor(path);
  auto bytes = readWholeFile(*storage, path);
  if (!bytes) return bytes.error();
  auto manifest = parseManifest(*bytes);
  if (!manifest) return inFile(manifest.error(), path);
  auto state = std::make_unique<State>();
  state->path = path;
  state->folder = path.substr(0, path.size() - fileNameOf(path).size());
  state->storage = storage;
  state->manifest = std::move(*manifest);
  state->checksum = hashBytes(*bytes);
  for (const ShardRecord& record : state->manifest.shards) state->shards.push_back({record.name, record.bytes, record.kind});
  state->files.resize(state->shards.size());
  state->opening.resize(state->shards.size());
  for (const ChildChunk& chunk : state->manifest.root->children)
    if (!state->holds(kKindIndex, chunk.record)) return Error{ErrorCode::kInvalidFile, path, "", "its root names bytes outside the shards", kRemedy};
  return World(std::move(state));
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, path, "", "out of memory while opening the world", "close other programs"};
}

World::World(std::unique_ptr<State> state) : state_(std::move(state)) {}
World::World(World&&) noexcept = default;
World& World::operator=(World&&) noexcept = default;
World::~World() = default;

const std::string& World::path() const { return state_->path; }
const WorldInfo& World::info() const { return state_->manifest.info; }
std::span<const LevelInfo> World::levels() const { return state_->manifest.levels; }
std::span<const ShardInfo> World::shards() const { return state_->shards; }
uint64_t World::checksum() const { return state_->checksum; }
const ChunkPtr& World::root() const { return state_->manifest.root; }

Result<const StoredFile*> World::State::file(uint32_t shard, const ReadOptions& options) const {
  std::unique_lock lock(mutex);
  for (; opening[shard]; opened.wait_for(lock, kLookAtOptions))
    if (const char* why = whyReadEnds(options)) return Error{ErrorCode::kIo, pathOf(shard), "", why, ""};
  if (files[shard]) return files[shard].get();
  Result<std::unique_ptr<StoredFile>> file = Error{ErrorCode::kIo, pathOf(shard), "", "out of memory", "close other programs"};
  opening[shard] = true;
  lock.unlock();
  try {
    file = openShard(*storage, pathOf(shard), manifest.shards[shard], options);
  } catch (const std::bad_alloc&) {
  }
  lock.lock();
  opening[shard] = false;
  opened.notify_all();
  if (!file) return file.error();
  if (all) (*file)->expectAll();
  files[shard] = std::move(*file);
  return files[shard].get();
}

Result<void> World::openShards(const ReadOptions& options) const {
  for (uint32_t shard = 0; shard < state_->shards.size(); ++shard)
    if (auto file = state_->file(shard, options); !file) return file.error();
  return {};
}

Result<int> World::descriptor(uint32_t shard, const ReadOptions& options) const {
  auto file = state_->file(shard, options);
  if (!file) return file.error();
  return (*file)->descriptor();
}

Result<void> World::readStored(const Extent& extent, std::span<std::byte> out, const ReadOptions& options) const {
  FF_CHECK_EQ(out.size(), size_t{extent.stored_bytes});
  auto file = state_->file(extent.shard, options);
  if (!file) return file.error();
  return (*file)->read(extent.offset, out, options);
}

void World::bring(std::span<const Extent> extents, const ReadOptions& options) const try {
  if (!state_->storage->brings()) return;
  std::map<uint32_t, std::vector<StoredFile::Range>> by_shard;
  for (const Extent& extent : extents) by_shard[extent.shard].push_back({extent.offset, extent.stored_bytes});
  std::vector<uint32_t> shards;
  for (const auto& [shard, ranges] : by_shard) shards.push_back(shard);
  inParallel(shards.size(), [&](size_t k) {
    try {
      if (const auto file = state_->file(shards[k], options)) (*file)->bring(by_shard.at(shards[k]), options);
    } catch (const std::bad_alloc&) {
    }
  });
} catch (const std::bad_alloc&) {
}

void World::bringChildren(std::span<const ChildRef> children, const ReadOptions& options) const try {
  std::vector<Extent> records;
  for (const auto& [parent, child] : children)
    if (!childHere(*parent, child)) records.push_back(parent->children[child].record);
  bring(records, options);
} catch (const std::bad_alloc&) {
}

void World::expectAll() { state_->all = true; }

namespace {

// Null: nobody holds it. With the world's lock held.
ChunkPtr childOf(const Chunk& parent, uint32_t child) { return parent.children_here.empty() ? nullptr : parent.children_here[child].lock(); }

}  // namespace

ChunkPtr World::childHere(const Chunk& parent, uint32_t child) const {
  const std::lock_guard lock(state_->mutex);
  return childOf(parent, child);
}

Result<ChunkPtr> World::child(const ChunkPtr& parent, uint32_t child, const ReadOptions& options) const try {
  const State& s = *state_;
  if (ChunkPtr here = childHere(*parent, child)) return here;
  const ChildChunk& wanted = parent->children[child];
  const auto inRecord = [&](Error e) {
    if (e.file.empty()) e.file = s.pathOf(wanted.record.shard);
    return e;
  };
  const auto bad = [&](const char* what) {
    return inRecord({ErrorCode::kInvalidFile, "", chunkText(parent->level - 1, wanted.cell) + " at offset " + std::to_string(wanted.record.offset), what, kRemedy});
  };
  std::vector<std::byte> stored(wanted.record.stored_bytes);
  if (auto ok = readStored(wanted.record, stored, options); !ok) return ok.error();
  if (hashBytes(stored) != wanted.record.checksum) {
    s.forget(wanted.record);
    return bad("checksum mismatch: bytes were changed, swapped or left over from another bake");
  }
  const size_t frame = ZSTD_findFrameCompressedSize(stored.data(), stored.size());
  if (ZSTD_isError(frame) || frame != stored.size() || ZSTD_getFrameContentSize(stored.data(), stored.size()) != wanted.record.raw_bytes)
    return bad("is not one zstd frame of the size that its parent says");
  std::vector<std::byte> raw(wanted.record.raw_bytes);
  if (ZSTD_decompress(raw.data(), raw.size(), stored.data(), stored.size()) != raw.size()) return bad("cannot be decompressed");
  auto chunk = decodeChunk(s.manifest.info, parent, child, raw);
  if (!chunk) return inRecord(chunk.error());
  bool inside = true;
  for (const TileInfo& tile : (*chunk)->tiles) inside = inside && s.holds(kKindRows, tile.strip);
  for (const GeometryInfo& geometry : (*chunk)->geometry) inside = inside && s.holds(kKindGeometry, geometry.strip);
  for (const ChildChunk& below : (*chunk)->children) inside = inside && s.holds(kKindIndex, below.record);
  if (!inside) return bad("names bytes outside the shards");
  const std::lock_guard lock(s.mutex);
  parent->children_here.resize(parent->children.size());
  std::weak_ptr<const Chunk>& entry = parent->children_here[child];
  if (ChunkPtr here = entry.lock()) return here;  // another thread was faster
  entry = *chunk;
  return std::move(*chunk);
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, state_->path, "", "out of memory for a chunk's index", "close other programs"};
}

namespace {

// What a compiler makes a call of memcmp of, if it is written as ==.
bool same(const ChunkCell& a, const ChunkCell& b) { return a[0] == b[0] && a[1] == b[1] && a[2] == b[2]; }

// Whether the record has the tile of that number.
bool holds(const Chunk& chunk, uint32_t tile) { return tile >= chunk.first_number && tile - chunk.first_number < chunk.tiles.size(); }

// The cell of `level` that a chunk of a finer level lies in.
ChunkCell ancestorOf(ChunkCell cell, uint32_t from, uint32_t level) {
  for (int32_t& a : cell) a >>= level - from;
  return cell;
}

// Below a chunk that covers the place, with the world's lock held. Null: it is not there, or in one of those that are put on `absent`, which nobody holds.
ChunkPtr search(const Chunk& at, uint32_t level, const TileName& name, std::vector<ChildRef>& absent) {
  if (at.level == level) return holds(at, name.tile) ? at.shared_from_this() : nullptr;
  const ChunkCell next = ancestorOf(name.chunk, level, at.level - 1);
  const uint8_t octant = octantOf(next);
  for (uint32_t k = 0; k < at.children.size(); ++k) {
    if (at.parent ? at.child_octants[k] != octant : !same(at.children[k].cell, next)) continue;
    ChunkPtr below = childOf(at, k);
    if (!below) {
      absent.push_back({at.shared_from_this(), k});
      continue;
    }
    if (below->level > level) below = search(*below, level, name, absent);
    else if (!holds(*below, name.tile)) continue;
    if (below) return below;
  }
  return nullptr;
}

// As search(), from any chunk of the level or above: from the lowest that covers the place up, as a cell may have several records.
ChunkPtr find(const Chunk& from, uint32_t level, const TileName& name, std::vector<ChildRef>& absent) {
  for (const Chunk* at = &from;; at = at->parent.get()) {
    if (at->parent && !same(at->cell, ancestorOf(name.chunk, level, at->level))) continue;
    ChunkPtr found = search(*at, level, name, absent);
    if (found || !at->parent || !absent.empty()) return found;
  }
}

}  // namespace

// Into `read`, so that they stay.
Result<void> World::readChildren(std::span<const ChildRef> children, std::vector<ChunkPtr>& read, const ReadOptions& options) const {
  bringChildren(children, options);
  for (const auto& [parent, number] : children) {
    auto chunk = child(parent, number, options);
    if (!chunk) return chunk.error();
    read.push_back(std::move(*chunk));
  }
  return {};
}

Result<TileRef> World::tile(TileId id) const {
  if (id.level >= levels().size() || id.tile >= levels()[id.level].tiles)
    return Error{ErrorCode::kUsage, state_->path, "", "has no tile " + std::to_string(id.level) + ":" + std::to_string(id.tile), "see ffinspect info"};
  auto chunk = chunkWith(id.level, &LevelCount::tiles, id.tile);
  if (!chunk) return chunk.error();
  const uint32_t index = id.tile - (*chunk)->firstTile();
  return TileRef{std::move(*chunk), index};
}

Result<TileRef> World::tileOfNode(uint32_t level, uint64_t node) const {
  if (level >= levels().size() || node >= levels()[level].nodes)
    return Error{ErrorCode::kUsage, state_->path, "", "has no node " + std::to_string(node) + " of level " + std::to_string(level), "see ffinspect info"};
  auto chunk = chunkWith(level, &LevelCount::nodes, node);
  if (!chunk) return chunk.error();
  const auto after = std::ranges::upper_bound((*chunk)->tiles, node, {}, &TileInfo::first_node);
  const auto index = static_cast<uint32_t>(after - (*chunk)->tiles.begin()) - 1;
  return TileRef{std::move(*chunk), index};
}

// Down the tree, by the counts of what lies in each child. The number is that of a tile or node of the level.
Result<ChunkPtr> World::chunkWith(uint32_t level, uint64_t LevelCount::*what, uint64_t number) const {
  ChunkPtr at = root();
  while (at->level > level) {
    uint64_t before = at->first[level].*what;
    uint32_t k = 0;
    while (before + at->children[k].counts[level].*what <= number) before += at->children[k++].counts[level].*what;
    auto below = child(at, k);
    if (!below) return below.error();
    at = std::move(*below);
  }
  return at;
}

Result<TileRef> World::tile(uint32_t level, const TileName& name) const {
  const auto none = [&](const std::string& what) { return Error{ErrorCode::kUsage, state_->path, "", what, "ffinspect locate names what is at a point"}; };
  if (level >= levels().size()) return none("has no level " + std::to_string(level));
  std::vector<ChunkPtr> read;
  for (std::vector<ChildRef> absent;; absent.clear()) {
    const ChunkPtr chunk = [&] {
      const std::lock_guard lock(state_->mutex);
      return find(*root(), level, name, absent);
    }();
    if (chunk) return TileRef{chunk, name.tile - chunk->first_number};
    if (absent.empty()) return none("has no tile " + std::to_string(name.tile) + " of " + chunkText(level, name.chunk));
    if (auto ok = readChildren(absent, read); !ok) return ok.error();
  }
}

Result<World::Tiles> World::childTiles(const TileRef& tile, const ReadOptions& options) const {
  const TileInfo& info = tile.info();
  auto below = child(tile.chunk, tile.chunk->childWith(info.first_child), options);
  if (!below) return below.error();
  const uint32_t first = (*below)->firstTile();
  return Tiles{std::move(*below), info.first_child - first, info.end_child - first};
}

// Partners in the order of blocks: of all blocks, or of those before one whose tile is nowhere, whose number is the answer. Chunks that are not here are
// read a level at a time.
Result<size_t> World::findPartners(const TileRef& tile, std::span<const PartnerName> names, PartnerChunks& partners, const ReadOptions& options) const {
  std::vector<ChildRef> absent, asked;
  for (std::vector<ChunkPtr> read;;) {
    partners.clear();
    absent.clear();
    const Chunk* at = nullptr;  // of the block before
    std::unique_lock lock(state_->mutex);
    for (size_t b = 0; b < names.size(); ++b) {
      if (!at || !same(names[b].step, names[b - 1].step) || !holds(*at, names[b].tile)) {
        ChunkCell cell;
        for (size_t a = 0; a < 3; ++a) cell[a] = static_cast<int32_t>(static_cast<uint32_t>(tile.chunk->cell[a]) + static_cast<uint32_t>(names[b].step[a]));
        asked.clear();
        ChunkPtr found = find(partners.empty() ? *tile.chunk : *partners.back().chunk, tile.chunk->level, {cell, names[b].tile}, asked);
        at = found.get();
        if (!at && asked.empty()) return b;
        if (!at) {
          absent.insert(absent.end(), asked.begin(), asked.end());
          continue;
        }
        partners.push_back({std::move(found), b});
      }
      partners.back().end_block = b + 1;
      __builtin_prefetch(&at->tiles[names[b].tile - at->first_number].nodes);  // they lie far apart
    }
    if (absent.empty()) return names.size();
    lock.unlock();
    const auto key = [](const ChildRef& c) { return std::pair(c.parent.get(), c.child); };
    std::ranges::sort(absent, {}, key);
    absent.erase(std::ranges::unique(absent, {}, key).begin(), absent.end());
    if (auto ok = readChildren(absent, read, options); !ok) return ok.error();
  }
}

Result<void> World::decodeStrip(const TileRef& tile, std::span<const std::byte> stored, Strip& out, PartnerChunks* partners, RowWords* words,
                                const ReadOptions& options) const {
  const State& s = *state_;
  const TileInfo& info = tile.info();
  thread_local std::vector<PartnerName> names;
  const auto inShard = [&](Error e) {
    e.file = s.pathOf(info.strip.shard);
    e.place = tileText(tile) + ", strip at offset " + std::to_string(info.strip.offset);
    return e;
  };
  if (auto ok = decodeStripBytes(info, s.manifest.info.quanta, stored, out, names, words); !ok) {
    s.forget(info.strip);
    return inShard(ok.error());
  }
  const auto bad = [&](size_t block, const char* what) {
    return inShard({ErrorCode::kInvalidFile, "", "", "block " + std::to_string(block) + " " + what, kRemedy});
  };
  PartnerChunks own;
  PartnerChunks& chunks = partners ? *partners : own;
  const auto found = findPartners(tile, names, chunks, options);
  if (!found) return found.error();
  if (*found < names.size()) return bad(*found, "names a tile that is not there");
  size_t b = 0;
  for (const auto& [chunk, end_block] : chunks)
    for (const uint32_t first_tile = chunk->firstTile(); b < end_block; ++b) {
      const uint32_t index = names[b].tile - chunk->first_number;
      out.blocks[b].partner_tile = first_tile + index;
      if (names[b].columns > chunk->tiles[index].nodes) return bad(b, "has a column outside the partner tile");
      if (b > 0 && out.blocks[b].partner_tile <= out.blocks[b - 1].partner_tile) return bad(b, "does not follow the block before in the order of tiles");
    }
  return {};
}

Result<Strip> World::strip(const TileRef& tile) const try {
  Strip out;
  const Extent& extent = tile.info().strip;
  std::vector<std::byte> stored(extent.stored_bytes);
  if (auto ok = readStored(extent, stored); !ok) return ok.error();
  if (auto ok = decodeStrip(tile, stored, out); !ok) return ok.error();
  return out;
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, state_->path, "", "out of memory for a strip", "close other programs"};
}

Result<Strip> World::strip(TileId id) const {
  auto found = tile(id);
  if (!found) return found.error();
  return strip(*found);
}

bool World::hasGeometry() const {
  return std::ranges::any_of(state_->shards, [](const ShardInfo& s) { return s.kind == kKindGeometry; });
}

Result<TileGeometry> World::geometry(uint32_t number) const {
  auto found = tile(TileId{0, number});
  if (!found) return found.error();
  return geometry(*found);
}

Result<TileGeometry> World::geometry(const TileRef& tile, const ReadOptions& options) const {
  const State& s = *state_;
  if (tile.chunk->geometry.empty())
    return Error{ErrorCode::kInvalidFile, s.path, "", "has no drawing geometry", "bake it with drawing geometry"};
  const GeometryInfo& info = tile.chunk->geometry[tile.index];
  const std::string path = s.pathOf(info.strip.shard);
  const auto bad = [&](const std::string& what) {
    return Error{ErrorCode::kInvalidFile, path, tileText(tile) + ", geometry at offset " + std::to_string(info.strip.offset), what, kRemedy};
  };
  std::vector<std::byte> stored(info.strip.stored_bytes);
  if (auto ok = readStored(info.strip, stored, options); !ok) return ok.error();
  if (hashBytes(stored) != info.strip.checksum) {
    s.forget(info.strip);
    return bad("checksum mismatch: bytes were changed, swapped or left over from another bake");
  }
  ByteReader r(std::span<const std::byte>(stored).first(kStripHeaderBytes));
  StripHeader h;
  StripHeader::fields(r, h);
  if (h.magic != kGeometryMagic) return bad("does not begin with FFGM");
  if (r.reservedUsed()) return bad("uses a reserved byte of the header");
  if (h.level != 0 || h.entries != info.triangles || h.blocks > h.entries || h.raw_bytes != 0 || h.chunks != 0 || h.payload_bytes != stored.size() - kStripHeaderBytes)
    return bad("header and index disagree");
  TileGeometry out;
  out.tile = tile.id().tile;
  if (auto ok = decodeGeometry(std::span<const std::byte>(stored).subspan(kStripHeaderBytes), info.triangles, tile.info().nodes, out); !ok)
    return bad(ok.error().message);
  out.sealed = h.blocks;
  const std::array<double, 3> corner = chunkCorner(s.manifest.info, 0, tile.chunk->cell);
  for (Vec3& p : out.positions) p = plusCorner(p, corner);
  return out;
}

}  // namespace ff::formats
