// Which tiles observers will want next, and when: those that come within their radius along the path that velocity and turn rate foretell, and
// a shell around the radius for turns that nothing foretells. Planned on a thread of its own, which also reads the index of what lies
// there; so a frame only takes the list.
#pragma once
#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <thread>
#include <vector>

#include "formats/read/reader.h"
#include "stream/streamer.h"
#include "stream/tile_map.h"

namespace ff::stream {

// Where the observer will be, at even steps from now to `seconds` ahead. turn: radians a second about the axis that it points along.
std::vector<Vec3> foretoldPath(Vec3 observer, Vec3 velocity, Vec3 turn, float seconds, size_t steps);

// How an observer turns, from one velocity to the next: a turn counts once it has lasted for two of them, so that a sharp corner is none.
class TurnRate {
 public:
  // seconds: since the last call. Radians a second.
  Vec3 follow(Vec3 velocity, float seconds);

 private:
  Vec3 velocity_, turn_;
};

class PathPlanner {
 public:
  static constexpr size_t kMaxTiles = 2048;  // of a plan
  struct Ahead {
    float seconds = 0;  // from when the plan was made to when the tile is wanted
    uint64_t bytes = 0;  // residentBytesBound()
    formats::TileId id;
    const formats::Chunk* chunk = nullptr;  // in Plan::chunks
    bool hinted = false;   // nothing but a hint says so
    float nearness = 0;    // of what is hinted: distance over radius
  };
  struct Plan {
    std::vector<Ahead> tiles;  // the soonest first; where it is the same, the nearest, coarser ones first
    struct Named {
      formats::TileId id;
      uint32_t rank = 0;  // number in `tiles`
    };
    std::vector<Named> by_id;
    std::vector<formats::ChunkPtr> chunks;  // the index of what is wanted, now and along the path
  };

  // The world outlives it. top: the coarsest level's chunks. Where the system has no thread, nothing is planned.
  PathPlanner(const formats::World& world, const StreamSettings& settings, std::span<const formats::ChunkPtr> top);
  ~PathPlanner();

  // The frame's: they allocate and free nothing.
  // latency_seconds: that reads take at present.
  // hints: kMaxObservers at most. lead: of what is wanted; so far as it goes with the fastest observer, more is wanted where hints are, in whatever direction.
  void aim(const Observers& observers, std::span<const Hint> hints, float latency_seconds, const Lead& lead);
  // Whether take() has something new; no lock.
  bool fresh() const { return fresh_.load(); }
  // The newest plan, for one that is given back.
  void take(std::unique_ptr<Plan>& plan);
  // Blocks until there is a plan for the last aim.
  void await() const;

 private:
  using Clock = std::chrono::steady_clock;
  struct Aim {
    Observers observers;
    float latency_seconds = 0;
    Lead lead;
    Clock::time_point at;
    std::array<Hint, kMaxObservers> hints;
    size_t hint_count = 0;
  };
  struct Here {
    formats::ChunkPtr chunk;
    uint32_t seen = 0;  // number of the last plan that looked at it
    Clock::time_point retry_at;  // null chunk: it could not be read
  };
  void work();
  void make(const Aim& aim, Plan& plan);
  void list(Plan& plan);
  bool readAbsent();
  const formats::Chunk* look(const formats::Chunk& parent, uint32_t child, Plan& plan);
  void visit(const formats::Chunk& chunk, uint32_t tile, Plan& plan);
  float secondsTo(const Box& bounds, uint32_t level) const;
  // Until the soonest of the places that are hinted and within whose radius it lies; nearness: as Ahead has it.
  float hintedIn(const Box& bounds, uint32_t level, float& nearness) const;

  const formats::World& world_;
  const StreamSettings settings_;
  std::vector<float> radius_m_;            // by level
  std::vector<formats::ChunkPtr> top_;
  TileMap<Here> chunks_;                   // by their first tile
  std::vector<formats::ChildRef> absent_;  // that a plan comes to and that are not here
  std::array<TurnRate, kMaxObservers> turn_rate_;
  Clock::time_point aimed_at_;
  uint32_t plans_ = 0;
  // Of the plan being made.
  struct Path {
    std::vector<Vec3> at;  // from where the observer is
    float step_seconds = 0, shell_m = 0, speed = 0;
  };
  float secondsTo(const Path& path, const Box& bounds, uint32_t level) const;
  std::vector<Path> paths_;  // of those that move
  struct Place {
    Vec3 at;
    float seconds;
  };
  std::vector<Place> places_;  // that are hinted
  float margin_m_ = 0;         // beyond the radius around them
  Observers observers_;

  mutable std::mutex mutex_;
  Aim aim_;
  std::unique_ptr<Plan> ready_;
  std::atomic<uint32_t> aims_{0}, planned_{0};  // aims so far; the one of the newest plan
  std::atomic<bool> fresh_{false}, stop_{false};
  std::thread thread_;
};

}  // namespace ff::stream
