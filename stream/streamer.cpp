#include "stream/streamer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <future>
#include <new>
#include <system_error>
#include <utility>

#include "stream/file_source.h"
#include "stream/strip_loader.h"
#include "stream/tile_cache.h"
#include "stream/tile_map.h"
#include "stream/wanted_tiles.h"

namespace ff::stream {
namespace {

using formats::TileId;

// How far ahead the queue looks along the velocity: about what a queue of reads takes to arrive.
constexpr float kLookAheadSeconds = 0.5f;

// A failed strip is read once more before it is given up.
Result<StripPtr> loadNow(const formats::World& world, TileSource& source, TileId id) {
  for (int attempt = 0;; ++attempt) {
    auto promise = std::make_shared<std::promise<Result<std::vector<std::byte>>>>();
    auto future = promise->get_future();
    source.read(id, {}, [promise](TileId, Result<std::vector<std::byte>> bytes) { promise->set_value(std::move(bytes)); });
    const Result<std::vector<std::byte>> bytes = future.get();
    auto strip = bytes ? decodeAndPack(world, id, *bytes) : Result<StripPtr>(bytes.error());
    if (strip || attempt == 1) return strip;
  }
}

class StreamerImpl final : public Streamer {
 public:
  StreamerImpl(const formats::World& world, const StreamSettings& settings, std::unique_ptr<TileSource> source)
      : world_(world),
        retry_after_(std::chrono::duration_cast<Clock::duration>(std::chrono::duration<float>(settings.retry_seconds))),
        wanted_(world, settings),
        cache_(settings.memory_bytes, wanted_.mostWanted() + kMoreCached),
        source_(std::move(source)),
        loader_(world, *source_, settings.queue_depth, settings.decode_threads, wanted_.mostWanted(), wanted_.mostWanted() + kMoreCached) {
    failures_.reserve(64);
    previous_.reserve(wanted_.mostWanted());
    missing_.reserve(wanted_.mostWanted());
    active_.reserve(wanted_.mostWanted());
    next_active_.reserve(wanted_.mostWanted());
  }

  Result<void> loadTop() {
    for (const formats::TileInfo& info : world_.tiles(static_cast<uint32_t>(world_.levels().size() - 1))) {
      auto strip = loadNow(world_, *source_, info.id);
      if (!strip) return strip.error();
      cache_.insert(std::move(*strip), true, loader_.retired());
      ++stats_.strips_read;
      stats_.bytes_read += info.stored_bytes;
      previous_.push_back(info.id);
    }
    chooseActive();
    return {};
  }

  bool update(Vec3 observer, Vec3 velocity) override {
    const bool moved = !started_ || !(observer == observer_);
    if (!moved && !loader_.anyArrived() && !isRetryDue()) return false;
    started_ = true;
    observer_ = observer;
    velocity_ = velocity;
    takeArrivals();
    if (moved) walk();
    queueMissing();
    return chooseActive();
  }

  std::span<const StripPtr> active() const override { return active_; }

  Result<void> settle() override {
    for (;;) {
      update(observer_, velocity_);
      if (loader_.backlog().idle()) return {};
      loader_.awaitProgress();
    }
  }

  StreamStats stats() const override {
    StreamStats stats = stats_;
    stats.evicted = cache_.evicted();
    stats.cancelled = loader_.cancelled();
    stats.resident_bytes = cache_.bytes();
    stats.peak_resident_bytes = cache_.peakBytes();
    stats.resident_tiles = cache_.tiles();
    stats.wanted_tiles = static_cast<uint32_t>(previous_.size());
    const StripLoader::Backlog backlog = loader_.backlog();
    stats.pending_tiles = backlog.queued + backlog.under_way + backlog.arrived;
    return stats;
  }

  std::string lastFailure() const override { return loader_.lastFailure(); }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr uint32_t kGivenUp = 2;       // failures
  static constexpr size_t kMoreCached = 8192;   // tiles, beyond those that are wanted
  struct Failure {
    uint32_t times = 0;
    Clock::time_point retry_at;
  };
  struct Missing {
    float need;  // distance over radius, where the observer will be
    TileId id;
  };

  void takeArrivals() {
    if (!loader_.anyArrived()) return;
    for (StripLoader::Arrival& arrival : loader_.take()) {
      ++stats_.strips_read;
      stats_.bytes_read += arrival.stored_bytes;
      const bool wanted = wanted_.isWanted(arrival.id);
      if (arrival.strip) {
        failures_.erase(arrival.id);
        cache_.insert(std::move(arrival.strip), wanted, loader_.retired());
      } else if (wanted) {
        fail(arrival.id);
      }
    }
  }

  void walk() {
    const std::span<const TileId> now = wanted_.walk(observer_);
    for (const TileId id : previous_) {
      if (wanted_.isWanted(id)) continue;
      cache_.setWanted(id, false);
      failures_.erase(id);  // the next visit may try again
    }
    for (const TileId id : now) cache_.setWanted(id, true);
    previous_.assign(now.begin(), now.end());
  }

  // Wanted tiles that are neither here nor given up; the loader leaves out those on their way.
  void queueMissing() {
    const Vec3 ahead = observer_ + velocity_ * kLookAheadSeconds;
    missing_.clear();
    for (const TileId id : previous_)
      if (!cache_.find(id) && !isGivenUp(id))
        missing_.push_back({world_.tiles(id.level)[id.tile].bounds.distance(ahead) / wanted_.radius(id.level), id});
    const bool had_queue = std::exchange(has_queue_, !missing_.empty());
    if (!had_queue && !has_queue_ && loader_.retired().empty()) return;
    // The most urgent last. A tile is of no use before its ancestors: coarser first where the need is the same.
    std::sort(missing_.begin(), missing_.end(), [](const Missing& a, const Missing& b) {
      if (a.need != b.need) return a.need > b.need;
      return a.id.level != b.id.level ? a.id.level < b.id.level : a.id.tile > b.id.tile;
    });
    for (const Missing& m : missing_) loader_.queue().push_back(m.id);
    loader_.submit();
  }

  // From the top down, so that ancestors are decided first. Returns whether the set has changed.
  bool chooseActive() {
    next_active_.clear();
    for (size_t i = previous_.size(); i-- > 0;) {
      const TileId id = previous_[i];
      const StripPtr& strip = cache_.find(id);
      if (!strip) continue;
      const bool top = id.level + 1 == world_.levels().size();
      const auto descends = [](const StripPtr& s, TileId other) { return s->id > other; };
      if (!top) {
        const TileId parent{id.level + 1, world_.parentTile(id)};
        const auto at = std::lower_bound(next_active_.begin(), next_active_.end(), parent, descends);
        if (at == next_active_.end() || (*at)->id != parent) continue;
      }
      next_active_.push_back(strip);
    }
    std::reverse(next_active_.begin(), next_active_.end());
    if (next_active_ == active_) return false;
    active_.swap(next_active_);
    return true;
  }

  void fail(TileId id) {
    Failure& failure = failures_[id];
    stats_.failed += ++failure.times == kGivenUp;
    failure.retry_at = Clock::now() + retry_after_;
  }
  bool isGivenUp(TileId id) {
    const auto at = failures_.find(id);
    return at != failures_.end() && at->second.times >= kGivenUp && Clock::now() < at->second.retry_at;
  }
  bool isRetryDue() const {
    return !failures_.empty() && std::ranges::any_of(failures_, [now = Clock::now()](const auto& f) { return now >= f.second.retry_at; });
  }

  const formats::World& world_;
  const Clock::duration retry_after_;
  WantedTiles wanted_;
  TileCache cache_;
  Vec3 observer_, velocity_;
  bool started_ = false, has_queue_ = false;
  std::vector<TileId> previous_;       // wanted by the last walk, sorted
  std::vector<Missing> missing_;
  TileMap<Failure> failures_;          // of wanted tiles
  std::vector<StripPtr> active_, next_active_;
  StreamStats stats_;
  std::unique_ptr<TileSource> source_;
  StripLoader loader_;  // last: its reads end before the source goes
};

Result<void> check(const formats::World& world, const StreamSettings& s) {
  const auto refuse = [&](const std::string& what, const char* remedy) {
    return Error{ErrorCode::kUsage, world.path(), "", what, remedy};
  };
  if (!(s.radius_m > 0) || !std::isfinite(s.radius_m))
    return refuse("radius_m is not positive", "give metres, such as 24");
  if (!(s.growth >= 1) || !std::isfinite(s.growth))
    return refuse("growth is below 1", "coarser levels reach farther; try 1.6");
  if (!(s.hysteresis >= 1) || !std::isfinite(s.hysteresis))
    return refuse("hysteresis is below 1", "a tile must not leave before it enters; try 1.15");
  if (!(s.retry_seconds > 0 && s.retry_seconds <= 1e6f)) return refuse("retry_seconds is not between 0 and 1e6", "try 5");
  uint64_t nodes = 0, bytes = 0;
  for (const formats::TileInfo& info : world.tiles(static_cast<uint32_t>(world.levels().size() - 1))) {
    nodes += info.nodes;
    bytes += residentBytesBound(world, info);
  }
  if (nodes > s.max_nodes)
    return refuse(
        "the top level alone has " + std::to_string(nodes) + " nodes, max_nodes is " + std::to_string(s.max_nodes),
        "raise max_nodes");
  if (bytes > s.memory_bytes)
    return refuse("the top level alone takes " + std::to_string(bytes) + " bytes, memory_bytes is " +
                      std::to_string(s.memory_bytes),
                  "raise memory_bytes");
  return {};
}

}  // namespace

Result<std::unique_ptr<Streamer>> Streamer::create(const formats::World& world, const StreamSettings& settings,
                                                   std::unique_ptr<TileSource> source) try {
  if (auto fit = check(world, settings); !fit) return fit.error();
  if (!source) source = makeFileSource(world);
  auto streamer = std::make_unique<StreamerImpl>(world, settings, std::move(source));
  if (auto loaded = streamer->loadTop(); !loaded) return loaded.error();
  return std::unique_ptr<Streamer>(std::move(streamer));
} catch (const std::system_error& e) {
  return Error{ErrorCode::kIo, world.path(), "", std::string("cannot start a thread: ") + e.what(), "close other programs, or raise the limit on processes"};
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, world.path(), "", "out of memory while preparing to stream the world", "close other programs"};
}

}  // namespace ff::stream
