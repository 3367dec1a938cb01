#include "stream/streamer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <future>
#include <new>
#include <optional>
#include <system_error>
#include <utility>

#include "formats/codec/records.h"
#include "stream/background_streamer.h"
#include "stream/file_source.h"
#include "stream/path_planner.h"
#include "stream/strip_loader.h"
#include "stream/tile_cache.h"
#include "stream/tile_map.h"
#include "stream/wanted_tiles.h"

namespace ff::stream {
namespace {

using formats::TileId;

constexpr uint64_t kWholeIndexBytes = 2 << 20;  // of a town of some 1.6M patches

// A failed strip is read once more before it is given up.
Result<StripPtr> loadNow(const formats::World& world, TileSource& source, const formats::TileRef& tile) {
  for (int attempt = 0;; ++attempt) {
    auto promise = std::make_shared<std::promise<Result<std::vector<std::byte>>>>();
    auto future = promise->get_future();
    source.read(tile.id(), tile.info().strip, {}, [promise](TileId, Result<std::vector<std::byte>> bytes) { promise->set_value(std::move(bytes)); });
    const Result<std::vector<std::byte>> bytes = future.get();
    auto strip = bytes ? decodeAndPack(world, tile, *bytes) : Result<StripPtr>(bytes.error());
    if (strip || attempt == 1) return strip;
  }
}

class StreamerImpl final : public Streamer {
 public:
  // top: the coarsest level's chunks.
  StreamerImpl(const formats::World& world, const StreamSettings& settings, std::unique_ptr<TileSource> source, std::span<const formats::ChunkPtr> top, Now now)
      : Streamer(radiiOf(world, settings.radius_m, settings.growth), settings.max_nodes),
        world_(world),
        retry_after_(std::chrono::duration_cast<Clock::duration>(std::chrono::duration<float>(settings.retry_seconds))),
        wanted_(world, settings),
        cache_(settings.memory_bytes, settings.kept_bytes, wanted_.maxWanted() + kMoreCached),
        source_(std::move(source)),
        loader_(world, *source_, settings.queue_depth, settings.decode_threads, wanted_.maxWanted() + PathPlanner::kMaxTiles, wanted_.maxWanted() + kMoreCached,
                RateLimit(settings.read_bytes_per_second), std::move(now)),
        ahead_bytes_(settings.ahead_bytes),
        hint_bytes_(settings.hint_bytes),
        memory_bytes_(settings.memory_bytes),
        lists_(wanted_.maxWanted()) {
    if (settings.ahead_seconds > 0 || settings.hint_bytes > 0) planner_.emplace(world, settings, top);
    for (const formats::ChunkPtr& chunk : top) wanted_.add(chunk);
    stats_.reach = {settings.radius_m, settings.growth};
    failures_.reserve(64);
    chunk_failures_.reserve(64);
    previous_.reserve(wanted_.maxWanted());
    missing_.reserve(wanted_.maxWanted() + PathPlanner::kMaxTiles);
    is_ahead_.reserve(PathPlanner::kMaxTiles);
    hints_.reserve(kMaxObservers);
  }

  Result<void> loadTop(std::span<const formats::ChunkPtr> top) {
    std::vector<formats::Extent> strips;
    for (const formats::ChunkPtr& chunk : top)
      for (const formats::TileInfo& tile : chunk->tiles) strips.push_back(tile.strip);
    world_.bring(strips);
    for (const formats::ChunkPtr& chunk : top)
      for (uint32_t t = 0; t < chunk->tiles.size(); ++t) {
        const formats::TileRef tile{chunk, t};
        auto strip = loadNow(world_, *source_, tile);
        if (!strip) return strip.error();
        cache_.insert(std::move(*strip), true, loader_.retired());
        ++stats_.reads;
        ++stats_.strips_read;
        stats_.bytes_read += tile.info().strip.stored_bytes;
        previous_.push_back(tile.id());
      }
    chooseActive();
    return {};
  }

  using Streamer::update;
  bool update(const Observers& observers) override {
    const bool turned = !(observers == observers_), moved = !started_ || observers.movedBy(0, observers_) || (lead_.shown_seconds > 0 && turned);
    const bool retries = isRetryDue();
    const bool hinted = std::exchange(hinted_, false) || forgetHints(hints_);
    if (planner_ && (moved || turned || hinted)) planner_->aim(observers, hints_, loader_.latencySeconds(), lead_);
    const bool planned = planner_ && planner_->fresh();
    lists_.forgetIdle();
    if (!moved && !loader_.anyArrived() && !retries && !planned) return false;
    started_ = true;
    observers_ = observers;
    bool index_grew = takeArrivals();
    if (planned) index_grew |= takePlan();
    if (moved || index_grew || retries) walk();
    limitAhead();
    cache_.trim(loader_.retired());
    queueMissing();
    return chooseActive();
  }

  void expect(std::span<const Hint> hints) override {
    FF_CHECK_LE(hints.size(), kMaxObservers);
    hints_.assign(hints.begin(), hints.end());
    hinted_ = true;
  }
  std::span<const Hint> expected() const override { return hints_; }
  void setLead(const Lead& lead) override {
    lead_.turn_seconds = std::clamp(lead.turn_seconds, 0.0f, kMaxLead_seconds);
    lead_.active_seconds = std::clamp(lead.active_seconds, lead_.turn_seconds, kMaxLead_seconds);
    lead_.shown_seconds = std::clamp(lead.shown_seconds, lead_.active_seconds, kMaxShownLead_seconds);
  }
  const StripList& activeList() const override { return active_; }

  Result<void> settle() override {
    for (;;) {
      update(observers_);
      if (planner_) planner_->await();
      if (planner_ && planner_->fresh()) continue;
      if (loader_.backlog().idle()) return {};
      loader_.awaitProgress();
    }
  }

  StreamStats stats() const override {
    StreamStats stats = stats_;
    stats.evicted = cache_.evicted();
    stats.reads += loader_.reads();
    stats.gap_bytes = loader_.gapBytes();
    stats.peak_stored_bytes = loader_.peakStoredBytes();
    stats.decode_ms = loader_.decodeMs();
    stats.cancelled = loader_.cancelled();
    stats.reads_held = loader_.readsHeld();
    stats.resident_bytes = cache_.bytes();
    stats.peak_resident_bytes = cache_.peakBytes();
    stats.resident_tiles = cache_.tiles();
    stats.wanted_tiles = static_cast<uint32_t>(previous_.size());
    stats.ahead_tiles = static_cast<uint32_t>(ahead_);
    stats.late_tiles = stats.wanted_tiles - static_cast<uint32_t>(active_->size());
    const StripLoader::Backlog backlog = loader_.backlog();
    stats.pending_tiles = backlog.queued + backlog.under_way + backlog.arrived;
    return stats;
  }

  std::string lastFailure() const override { return loader_.lastFailure(); }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr uint32_t kGivenUp = 2;       // failures
  static constexpr size_t kMoreCached = 8192;   // tiles, beyond those that are wanted
  static constexpr float kAimSeconds = 0.5f;    // of what is late, tiles in front of the observer come first
  static constexpr float kAheadNeed = 1e6f;     // what is late comes before what is ahead
  struct Failure {
    uint32_t times = 0;
    Clock::time_point retry_at;
  };
  struct Missing {
    float need;  // distance over radius, where the observer will be; kAheadNeed and the seconds until then of what is read ahead
    WantedTiles::Tile tile;
  };

  // Returns whether a chunk has come.
  bool takeArrivals() {
    if (!loader_.anyArrived()) return false;
    for (StripLoader::Arrival& arrival : loader_.take()) {
      ++stats_.strips_read;
      stats_.bytes_read += arrival.stored_bytes;
      const bool wanted = wanted_.isWanted(arrival.id) || isAhead(arrival.id);
      if (arrival.strip) {
        failures_.erase(arrival.id);
        cache_.insert(std::move(arrival.strip), wanted, loader_.retired());
      } else if (wanted) {
        fail(failures_, arrival.id);
      }
    }
    bool index_grew = false;
    for (StripLoader::ChunkArrival& arrival : loader_.takeChunks()) {
      if (!arrival.chunk) {
        fail(chunk_failures_, arrival.id);
        continue;
      }
      chunk_failures_.erase(arrival.id);
      wanted_.add(std::move(arrival.chunk));
      index_grew = true;
    }
    return index_grew;
  }

  // Returns whether it brought chunks.
  bool takePlan() {
    planner_->take(next_plan_);
    // Tiles that the new plan has no more, too.
    for (size_t rank = 0; rank < is_ahead_.size(); ++rank)
      if (std::exchange(is_ahead_[rank], 0)) dropAhead(plan_->tiles[rank].id);
    std::swap(plan_, next_plan_);
    is_ahead_.assign(plan_->tiles.size(), 0);
    bool index_grew = false;
    for (const formats::ChunkPtr& chunk : plan_->chunks) {
      if (wanted_.has(chunk->tiles[0].id)) continue;
      wanted_.add(chunk);
      index_grew = true;
    }
    return index_grew;
  }

  // As much of the plan, the soonest first, as there is memory for beside what is wanted; of paths and of hints each within its budget.
  void limitAhead() {
    uint64_t room = memory_bytes_ - std::min(memory_bytes_, wanted_.bytes());
    uint64_t left[] = {ahead_bytes_, hint_bytes_};
    ahead_ = 0;
    for (size_t rank = 0; rank < plan_->tiles.size(); ++rank) {
      const PathPlanner::Ahead& tile = plan_->tiles[rank];
      uint64_t& budget = left[tile.hinted];
      const bool fits = tile.bytes <= std::min(budget, room);
      if (fits) {
        budget -= tile.bytes;
        room -= tile.bytes;
        ++ahead_;
      } else {
        budget = 0;  // nothing that is wanted later takes its place
      }
      if (std::exchange(is_ahead_[rank], fits) == fits) continue;
      if (fits)
        cache_.setWanted(tile.id, true);
      else
        dropAhead(tile.id);
    }
  }
  bool isAhead(TileId id) const {
    const auto at = std::ranges::lower_bound(plan_->by_id, id, {}, &PathPlanner::Plan::Named::id);
    return at != plan_->by_id.end() && at->id == id && is_ahead_[at->rank];
  }
  void dropAhead(TileId id) {
    if (!wanted_.isWanted(id)) cache_.setWanted(id, false);
  }

  void walk() {
    const std::span<const WantedTiles::Tile> now = wanted_.walk(observers_, lead_);
    stats_.reach = wanted_.reach();
    if (stats_.first_short.short_of == Budget::kNone && stats_.reach.short_of != Budget::kNone) {
      stats_.first_short = stats_.reach;
      stats_.first_short_at = observers_[0].at;
    }
    for (const TileId id : previous_) {
      if (wanted_.isWanted(id) || isAhead(id)) continue;
      cache_.setWanted(id, false);
    }
    previous_.clear();
    for (const WantedTiles::Tile& tile : now) {
      cache_.setWanted(tile.id, true);
      previous_.push_back(tile.id);
    }
    wanted_.forget(loader_.retired());
  }

  // Tiles that are wanted, now or ahead, and are neither here nor given up; the loader leaves out those on their way.
  void queueMissing() {
    missing_.clear();
    for (const WantedTiles::Tile& tile : wanted_.wanted())
      if (isMissing(tile.id)) missing_.push_back({observers_.distance(tile.info().bounds, kAimSeconds) / wanted_.radius(tile.id.level), tile});
    for (size_t rank = 0; rank < is_ahead_.size(); ++rank)
      if (const PathPlanner::Ahead& tile = plan_->tiles[rank]; is_ahead_[rank] && isMissing(tile.id) && !wanted_.isWanted(tile.id))
        missing_.push_back({kAheadNeed + tile.seconds, {tile.id, tile.chunk}});
    forgetFailures();
    for (const formats::ChildRef& request : wanted_.missingChunks())
      if (!isGivenUp(chunk_failures_, request.id())) loader_.chunkQueue().push_back(request);
    const bool had_queue = std::exchange(has_queue_, !missing_.empty() || !loader_.chunkQueue().empty());
    if (!had_queue && !has_queue_ && loader_.retired().empty()) return;
    // The most urgent last. A tile is of no use before its ancestors: coarser first where the need is the same.
    std::sort(missing_.begin(), missing_.end(), [](const Missing& a, const Missing& b) {
      if (a.need != b.need) return a.need > b.need;
      return a.tile.id.level != b.tile.id.level ? a.tile.id.level < b.tile.id.level : a.tile.id.tile > b.tile.id.tile;
    });
    for (const Missing& m : missing_) loader_.queue().push_back(m.tile.ref());
    loader_.submit();
  }

  // From the top down, so that ancestors are decided first. Returns whether the set has changed.
  bool chooseActive() {
    const auto next = lists_.next();
    for (size_t i = previous_.size(); i-- > 0;) {
      const StripPtr& strip = cache_.find(previous_[i]);
      if (strip && canStand(strip->tile, *next)) next->push_back(strip);
    }
    std::ranges::reverse(*next);
    if (*next == *active_) return false;
    active_ = next;
    return true;
  }

  // Whether the tiles above are in `active`, the last tiles first, but for those that failed.
  bool canStand(const formats::TileRef& tile, std::span<const StripPtr> active) const {
    const formats::Chunk* chunk = tile.chunk.get();
    for (uint32_t at = tile.index; !chunk->isTop();) {
      const TileId parent{chunk->level + 1, chunk->tiles[at].parent_tile};
      const auto descends = [](const StripPtr& s, TileId other) { return s->id > other; };
      const auto found = std::lower_bound(active.begin(), active.end(), parent, descends);
      if (found != active.end() && (*found)->id == parent) return true;
      if (!givenUp(failures_, parent)) return false;
      chunk = chunk->parent.get();
      at = parent.tile - chunk->firstTile();
    }
    return true;
  }
  using Failures = TileMap<Failure>;
  void fail(Failures& failures, TileId id) {
    Failure& failure = failures[id];
    stats_.failed += ++failure.times == kGivenUp;
    failure.retry_at = Clock::now() + retry_after_;
  }
  // Null: it has not failed so often.
  static const Failure* givenUp(const Failures& failures, TileId id) {
    const auto at = failures.find(id);
    return at != failures.end() && at->second.times >= kGivenUp ? &at->second : nullptr;
  }
  static bool isGivenUp(const Failures& failures, TileId id) {
    const Failure* failure = givenUp(failures, id);
    return failure && Clock::now() < failure->retry_at;
  }
  // Of what the observer has left: the next visit may try again.
  void forgetFailures() {
    for (auto at = failures_.begin(); at != failures_.end();)
      at = wanted_.isWanted(at->first) || std::ranges::binary_search(plan_->by_id, at->first, {}, &PathPlanner::Plan::Named::id) ? std::next(at) : failures_.erase(at);
    for (auto at = chunk_failures_.begin(); at != chunk_failures_.end();)
      at = std::ranges::any_of(wanted_.missingChunks(), [id = at->first](const formats::ChildRef& r) { return r.id() == id; }) ? std::next(at) : chunk_failures_.erase(at);
  }
  bool isRetryDue() const {
    for (const Failures* failures : {&failures_, &chunk_failures_})
      if (!failures->empty() && std::ranges::any_of(*failures, [now = Clock::now()](const auto& f) { return now >= f.second.retry_at; })) return true;
    return false;
  }

  bool isMissing(TileId id) const { return !cache_.find(id) && !isGivenUp(failures_, id); }

  const formats::World& world_;
  const Clock::duration retry_after_;
  WantedTiles wanted_;
  TileCache cache_;
  Observers observers_;
  bool started_ = false, has_queue_ = false;
  std::vector<TileId> previous_;       // wanted by the last walk, sorted
  std::vector<Missing> missing_;
  Failures failures_;                  // of tiles wanted now or ahead
  Failures chunk_failures_;            // by their first tile
  StreamStats stats_;
  std::unique_ptr<TileSource> source_;
  StripLoader loader_;  // its reads end before the source goes
  Lead lead_;
  const uint64_t ahead_bytes_, hint_bytes_, memory_bytes_;
  std::vector<Hint> hints_;
  bool hinted_ = false;  // hints_ are others than the planner has
  std::optional<PathPlanner> planner_;
  std::unique_ptr<PathPlanner::Plan> plan_ = std::make_unique<PathPlanner::Plan>(), next_plan_ = std::make_unique<PathPlanner::Plan>();
  StripLists lists_;
  StripList active_ = lists_.next();
  std::vector<uint8_t> is_ahead_;  // by number in plan_->tiles: there is memory for it, so that it is kept and read
  size_t ahead_ = 0;               // so many of them
};

Result<void> check(const formats::World& world, const StreamSettings& s, std::span<const formats::ChunkPtr> top) {
  const auto refuse = [&](const std::string& what, const char* remedy) {
    return Error{ErrorCode::kUsage, world.path(), "", what, remedy};
  };
  if (!(s.radius_m > 0) || !std::isfinite(s.radius_m))
    return refuse("radius_m is not positive", "give metres, such as 24");
  if (!(s.growth >= 1) || !std::isfinite(s.growth))
    return refuse("growth is below 1", "coarser levels reach farther; try 1.3");
  if (!(s.hysteresis >= 1) || !std::isfinite(s.hysteresis))
    return refuse("hysteresis is below 1", "a tile must not leave before it enters; try 1.15");
  if (!(s.ahead_seconds >= 0 && s.ahead_seconds <= 10)) return refuse("ahead_seconds is not between 0 and 10", "try 0.5");
  if (!(s.retry_seconds > 0 && s.retry_seconds <= 1e6f)) return refuse("retry_seconds is not between 0 and 1e6", "try 5");
  uint64_t nodes = 0, bytes = 0;
  for (const formats::ChunkPtr& chunk : top)
    for (const formats::TileInfo& info : chunk->tiles) {
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

// Over a network: of a small world the index whole, which else costs a round trip for each level at least; of a large one the coarsest chunks. The
// shard of the coarsest strips is opened meanwhile.
void bringBeginning(const formats::World& world) {
  std::vector<formats::Extent> index;
  uint64_t index_bytes = 0;
  const auto shards = world.shards();
  for (uint32_t shard = 0; shard < shards.size(); ++shard) {
    if (shards[shard].kind != formats::kKindIndex) continue;
    index_bytes += shards[shard].bytes;
    index.push_back({.shard = shard, .offset = 0, .stored_bytes = static_cast<uint32_t>(std::min(shards[shard].bytes, kWholeIndexBytes))});
  }
  if (index_bytes > kWholeIndexBytes) {
    index.clear();
    for (const formats::ChildChunk& chunk : world.root()->children) index.push_back(chunk.record);
  }
  index.push_back({.shard = 0, .offset = 0, .stored_bytes = formats::kShardHeaderBytes});
  world.bring(index);
}

}  // namespace

Result<std::unique_ptr<Streamer>> Streamer::create(const formats::World& world, const StreamSettings& settings,
                                                   std::unique_ptr<TileSource> source, Now now) try {
  bringBeginning(world);
  std::vector<formats::ChunkPtr> top;
  for (uint32_t k = 0; k < world.root()->children.size(); ++k) {
    auto chunk = world.child(world.root(), k);
    if (!chunk) return chunk.error();
    top.push_back(std::move(*chunk));
  }
  if (auto fit = check(world, settings, top); !fit) return fit.error();
  if (!source) source = makeFileSource(world);
  auto streamer = std::make_unique<StreamerImpl>(world, settings, std::move(source), top, std::move(now));
  if (auto loaded = streamer->loadTop(top); !loaded) return loaded.error();
  if (!settings.background) return std::unique_ptr<Streamer>(std::move(streamer));
  return inBackground(std::move(streamer));
} catch (const std::system_error& e) {
  return Error{ErrorCode::kIo, world.path(), "", std::string("cannot start a thread: ") + e.what(), "close other programs, or raise the limit on processes"};
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, world.path(), "", "out of memory while preparing to stream the world", "close other programs"};
}

}  // namespace ff::stream
