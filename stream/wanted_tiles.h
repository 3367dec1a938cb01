// Which tiles the observer wants: a best-first walk down the hierarchy that visits only what it admits and its
// children. It goes by the index of the chunks that are here, and says which others it would have looked at.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "stream/streamer.h"
#include "stream/strip_loader.h"
#include "stream/tile_map.h"

namespace ff::stream {

// Bytes in memory, at most, of a tile that is not decoded yet.
uint64_t residentBytesBound(const formats::World& world, const formats::TileInfo& info);

// Within which a tile is wanted, m, by its level.
std::vector<float> radiiOf(const formats::World& world, float radius_0, float growth);

// The wanted set; walks allocate nothing, but for a heap that outgrows kHeapAtFirst once. The top level is always wanted; another tile when its parent tile is and its bounds
// are within its level's radius of the observer (times hysteresis if the walk before wanted it).
// Tiles are admitted in order of their urgency (their own or an ancestor's, whichever is larger), so a budget that runs out acts as
// a smaller growth, down to kLeastGrowth of what it is above 1, and then as a smaller radius_m: max_nodes and memory_bytes end the walk,
// max_level0_nodes only closes level 0. What is wanted for its light alone, so that it has followed when an observer is there (Lead::shown_seconds), comes after that, and what is wanted for a turn alone
// (Lead::turn_seconds) after all else, with no hysteresis of its own.
class WantedTiles {
 public:
  struct Tile {
    formats::TileId id;
    const formats::Chunk* chunk = nullptr;  // here as long as the tile is wanted
    bool spare = false;                     // for a turn alone
    const formats::TileInfo& info() const { return chunk->tiles[id.tile - chunk->firstTile()]; }
    formats::TileRef ref() const { return {chunk->shared_from_this(), id.tile - chunk->firstTile()}; }
  };

  WantedTiles(const formats::World& world, const StreamSettings& settings);

  // A chunk's index has come: the next walk goes on there.
  void add(formats::ChunkPtr chunk);
  // Wanted tiles sorted by (level, tile). Valid until the next walk.
  // What is near where the observers will be after the lead, or on the way, is as near.
  std::span<const Tile> walk(const Observers& observers, const Lead& lead);
  std::span<const Tile> wanted() const { return wanted_; }
  // Chunks beyond which the last walk could not look, the most urgent last. Valid until the next walk.
  std::span<const formats::ChildRef> missingChunks() const { return missing_; }
  // Hands over chunks that no walk has looked at for long.
  void forget(std::vector<std::shared_ptr<const void>>& leaving);
  bool has(formats::TileId first_tile) const { return chunks_.contains(first_tile); }  // a chunk
  uint64_t bytes() const { return bytes_; }  // of the last walk's tiles, at most
  const Reach& reach() const { return reach_; }  // of the last walk
  bool isWanted(formats::TileId id) const { return find(wanted_, id); }
  // Tiles of a walk, at most.
  size_t maxWanted() const { return max_wanted_; }
  float radius(uint32_t level) const { return radius_m_[level]; }
  size_t chunks() const { return chunks_.size(); }

 private:
  struct Candidate {
    float key = 0;  // urgency
    Tile tile;
    // For a heap whose front is next: nearest first, then the coarser level, then the lower tile.
    friend bool operator<(const Candidate& a, const Candidate& b) {
      if (a.key != b.key) return a.key > b.key;
      if (a.tile.id.level != b.tile.id.level) return a.tile.id.level < b.tile.id.level;
      return a.tile.id.tile > b.tile.id.tile;
    }
  };
  struct Here {
    formats::ChunkPtr chunk;
    uint32_t seen = 0;  // number of the last walk that looked at it
  };
  static const Tile* find(std::span<const Tile> tiles, formats::TileId id) {
    const auto at = std::ranges::lower_bound(tiles, id, {}, &Tile::id);
    return at != tiles.end() && at->id == id ? &*at : nullptr;
  }
  const formats::Chunk* look(const formats::Chunk& parent, uint32_t child);
  void admit(const Tile& tile);
  void offerChildren(const Tile& parent);
  // Of a tile that is so far from the way of Lead::active_seconds. Below 1 within the radii of the least growth, where it is the distance over them; from there to the level's radius, 1 to 2; beyond it, up
  // to kTurn, by the way that is left.
  float urgency(float distance, uint32_t level) const;
  static constexpr float kLight = 2, kTurn = 3;
  std::span<const float> shownSeconds(uint32_t level) const { return std::span(shown_seconds_).subspan(level * kMaxObservers, kMaxObservers); }
  // A budget ran out at a candidate.
  void ranOut(Budget budget, const Candidate& at);
  // To the nearest observer's way, each as long as its velocity lasts: near enough by its ends and its place that is nearest to the middle of the box.
  float distance(const Box& bounds, std::span<const float> seconds) const {
    float nearest = observers_.distance(bounds);
    for (size_t i = 0; i < observers_.size(); ++i) {
      const Observer& observer = observers_[i];
      const Vec3 way = observer.velocity * seconds[i];
      if (way == Vec3{}) continue;
      const float along = std::clamp(dot((bounds.lo + bounds.hi) * 0.5f - observer.at, way) / dot(way, way), 0.0f, 1.0f);
      nearest = std::min({nearest, bounds.distance(observer.at + way), bounds.distance(observer.at + way * along)});
    }
    return nearest;
  }

  const formats::World& world_;
  const StreamSettings settings_;
  Observers observers_;  // of the walk
  size_t max_wanted_ = 0;
  const float least_growth_;
  std::vector<float> radius_m_, least_radius_m_;  // per level; those of the least growth
  std::array<float, kMaxObservers> active_seconds_{};  // of the lead, by observer,
  std::vector<float> shown_seconds_;                    // and what a level has left of it: by level and observer
  float turn_m_ = 0;             // the fastest observer's way in the time of a turn
  TileMap<Here> chunks_;         // by their first tile
  uint32_t walks_ = 0;
  std::vector<Candidate> heap_;
  std::vector<Tile> wanted_, wanted_before_;  // by the last walk, by the one before; sorted
  std::vector<formats::ChildRef> missing_;
  TileSet asked_;                             // of missing_
  Reach reach_;
  uint64_t bytes_ = 0;
  uint32_t nodes_ = 0, level0_nodes_ = 0;
  bool level0_closed_ = false;
};

}  // namespace ff::stream
