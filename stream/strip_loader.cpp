#include "stream/strip_loader.h"

#include <algorithm>
#include <array>
#include <new>
#include <utility>

#include "stream/latency.h"
#include "stream/start_threads.h"

namespace ff::stream {

using formats::ChildRef;
using formats::TileId;
using formats::TileRef;

namespace {

// Counters may wrap.
bool isAfter(uint32_t a, uint32_t b) { return static_cast<int32_t>(a - b) > 0; }

constexpr const char* kOutOfMemory = "out of memory";  // short enough for a string to need none
constexpr std::chrono::milliseconds kHeldLook{2};      // whether the limit lets the next read begin
constexpr size_t kMaxChunks = 1024;                    // asked for at once; more wait for the next time
constexpr size_t kMaxArrivedChunks = 64;               // that wait to be taken
constexpr size_t kStripsPerRead = 16;                  // at most
constexpr size_t kMostWaiting = 32;                    // strips that wait to be taken when a read begins
constexpr size_t kNextOfQueue = 64;                    // of these the neighbours of the most urgent share its read

// What holds both, where they may share a read.
std::optional<formats::Extent> together(const formats::Extent& read, const formats::Extent& strip, const SharedReads& shared) {
  if (strip.shard != read.shard) return std::nullopt;
  const uint64_t from = std::min(read.offset, strip.offset), to = std::max(read.offset + read.stored_bytes, strip.offset + strip.stored_bytes);
  const uint64_t max_bytes = uint64_t{read.stored_bytes} + strip.stored_bytes + shared.gap_bytes;
  if (to - from > std::min<uint64_t>(max_bytes, shared.max_bytes)) return std::nullopt;
  return formats::Extent{.shard = read.shard, .offset = from, .stored_bytes = static_cast<uint32_t>(to - from)};
}

}  // namespace

Result<StripPtr> decodeAndPack(const formats::World& world, const TileRef& tile, std::span<const std::byte> stored, const formats::ReadOptions& options) {
  formats::Strip strip;
  formats::World::PartnerChunks chunks;
  formats::RowWords words;
  if (auto decoded = world.decodeStrip(tile, stored, strip, &chunks, &words, options); !decoded) return decoded.error();
  return std::make_shared<const ResidentStrip>(pack(std::move(strip), std::move(words), tile, chunks));
}

Result<StripPtr> readResident(const formats::World& world, const TileRef& tile) {
  std::vector<std::byte> stored(tile.info().strip.stored_bytes);
  if (auto read = world.readStored(tile.info().strip, stored); !read) return read.error();
  return decodeAndPack(world, tile, stored);
}

StripLoader::StripLoader(const formats::World& world, TileSource& source, int depth, int decode_threads,
                         size_t max_queued, size_t max_retired, RateLimit limit, Now now)
    : world_(world),
      source_(source),
      shared_(source.sharedReads()),
      depth_(static_cast<size_t>(std::max(std::min(depth, source.readsAtOnce()), 1))),
      max_waiting_(std::min(2 * depth_, kMostWaiting)),
      strips_at_once_(depth_ * std::max(shared_.strips_per_read, 1u)),
      limit_(limit),
      now_(std::move(now)) {
  // Lists change places when they are handed over, so each has room for the most that any of them can hold.
  for (Queue* queue : {&next_, &submitted_, &incoming_, &queue_}) {
    queue->tiles.reserve(max_queued);
    queue->chunks.reserve(kMaxChunks);
  }
  sorted_.reserve(max_queued);
  const size_t max_under_way = strips_at_once_ - 1 + kStripsPerRead;
  const size_t max_arrived = max_waiting_ + max_under_way;  // that wait, and what was under way then
  for (std::vector<Arrival>* list : {&taken_, &arrived_}) list->reserve(max_arrived);
  for (std::vector<ChunkArrival>* list : {&taken_chunks_, &arrived_chunks_}) list->reserve(kMaxArrivedChunks);
  for (auto* list : {&next_retired_, &submitted_retired_, &incoming_retired_}) list->reserve(max_retired + 2 * max_arrived);
  under_way_.reserve(max_under_way);
  chunks_under_way_.reserve(kMaxArrivedChunks);
  since_taken_.reserve(4 * max_arrived);
  startThreads(threads_, std::max(decode_threads, 1), [this] { work(); });
}

StripLoader::~StripLoader() {
  {
    const std::lock_guard lock(pipeline_mutex_);
    stop_ = cancel_reads_ = true;
  }
  wake();
  for (std::thread& thread : threads_) thread.join();
  // Nobody starts reads any more.
  std::unique_lock lock(pipeline_mutex_);
  reads_done_.wait(lock, [this] { return reads_ == 0; });
}

void StripLoader::submit() {
  if (next_.chunks.size() > kMaxChunks) next_.chunks.erase(next_.chunks.begin(), next_.chunks.end() - kMaxChunks);
  next_.taken = taken_count_;
  {
    const std::lock_guard lock(hand_over_mutex_);
    std::swap(submitted_, next_);
    fresh_ = true;
    if (submitted_retired_.empty()) submitted_retired_.swap(next_retired_);
    submitted_count_.store(submitted_.size());
  }
  next_.clear();
  wake();
}

std::vector<StripLoader::Arrival>& StripLoader::take() {
  taken_.clear();
  {
    const std::lock_guard lock(hand_over_mutex_);
    arrived_.swap(taken_);
    arrived_count_.store(0);
  }
  taken_count_ += static_cast<uint32_t>(taken_.size());
  return taken_;
}

std::vector<StripLoader::ChunkArrival>& StripLoader::takeChunks() {
  taken_chunks_.clear();
  const std::lock_guard lock(hand_over_mutex_);
  arrived_chunks_.swap(taken_chunks_);
  arrived_chunk_count_.store(0);
  return taken_chunks_;
}

StripLoader::Backlog StripLoader::backlog() const {
  Backlog backlog;
  backlog.queued = submitted_count_.load();
  backlog.queued += queued_count_.load();
  backlog.under_way = under_way_count_.load();
  backlog.arrived = arrived_count_.load();
  backlog.arrived += arrived_chunk_count_.load();
  return backlog;
}

std::string StripLoader::lastFailure() const {
  const std::lock_guard lock(pipeline_mutex_);
  return failure_.line();
}

void StripLoader::awaitProgress() const {
  for (;;) {
    const uint32_t seen = progress_.load();
    const Backlog now = backlog();
    if (now.arrived != 0 || now.idle()) return;
    progress_.wait(seen);
  }
}

void StripLoader::wake() {
  wake_.fetch_add(1);
  wake_.notify_all();
}

void StripLoader::progress() {
  progress_.fetch_add(1);
  progress_.notify_all();
}

void StripLoader::work() {
  for (std::array<ChildRef, kMaxArrivedChunks> chunks;;) {
    const uint32_t seen = wake_.load();
    pickUp();
    startReads();
    if (const std::span<ChildRef> requests = nextChunks(chunks); !requests.empty()) {
      readChunks(requests);
      continue;
    }
    if (const std::optional<Stored> stored = nextToDecode()) {
      decode(*stored);
      continue;
    }
    bool held = false;
    {
      const std::lock_guard lock(pipeline_mutex_);
      if (stop_) return;
      held = held_;
    }
    if (held)
      std::this_thread::sleep_for(kHeldLook);
    else
      wake_.wait(seen);
  }
}

void StripLoader::pickUp() {
  const std::lock_guard lock(pipeline_mutex_);
  bool fresh = false;
  {
    const std::lock_guard hand_over_lock(hand_over_mutex_);
    submitted_retired_.swap(incoming_retired_);
    fresh = std::exchange(fresh_, false);
    if (fresh) {
      std::swap(submitted_, incoming_);
      queued_count_.store(incoming_.size());
      submitted_count_.store(0);
    }
  }
  freeRetired();
  if (!fresh) return;
  sorted_.clear();
  for (const TileRef& tile : incoming_.tiles) sorted_.push_back(tile.id());
  std::ranges::sort(sorted_);
  const auto dropped = [this](const TileRef& tile) { return !std::ranges::binary_search(sorted_, tile.id()) && !isOnItsWay(tile.id()); };
  cancelled_.fetch_add(static_cast<uint64_t>(std::ranges::count_if(queue_.tiles, dropped)));
  std::erase_if(since_taken_, [this](const auto& arrival) { return !isAfter(arrival.first, incoming_.taken); });
  std::swap(queue_, incoming_);
  incoming_.clear();
  progress();
}

// Nobody can come to share what the list alone holds, so a count of 1 stays.
void StripLoader::freeRetired() {
  for (auto& item : incoming_retired_) try {
      retired_.push_back(std::move(item));
    } catch (const std::bad_alloc&) {  // whoever holds it last frees it
    }
  incoming_retired_.clear();
  std::erase_if(retired_, [](const auto& item) { return item.use_count() == 1; });
}

void StripLoader::startReads() {
  while (const std::optional<Read> read = nextRead()) try {
      source_.read(read->id, read->extent, {.cancelled = &cancel_reads_},
                   [this, number = read->number](TileId, Result<std::vector<std::byte>> bytes) { onRead(number, std::move(bytes)); });
    } catch (const std::bad_alloc&) {
      onRead(read->number, Error{ErrorCode::kIo, "", "", kOutOfMemory, ""});
    }
}

std::optional<StripLoader::Read> StripLoader::nextRead() {
  const std::lock_guard lock(pipeline_mutex_);
  const bool was_held = std::exchange(held_, false);
  const Clock::time_point now = now_();
  std::optional<Read> read;
  if (!stop_ && reads_ < depth_) {
    read = nextAlone();
    if (!read) read = nextQueued(now);
  }
  if (read) {
    reads_held_.fetch_add(was_held);
    reads_begun_.fetch_add(1);
    ++reads_;
  }
  countQueued();
  return read;
}

// A strip whose shared read has failed. The limit has let it begin before.
std::optional<StripLoader::Read> StripLoader::nextAlone() {
  const auto at = std::ranges::find(under_way_, true, &UnderWay::alone);
  if (at == under_way_.end()) return std::nullopt;
  at->alone = false;
  at->read = nextNumber();
  return Read{at->read, at->id(), at->tile.info().strip};
}

std::optional<StripLoader::Read> StripLoader::nextQueued(Clock::time_point now) {
  while (!queue_.tiles.empty() && under_way_.size() < strips_at_once_ && arrived_count_.load() < max_waiting_) {
    if (!limit_.lets(now)) {
      held_ = true;
      return std::nullopt;
    }
    TileRef tile = std::move(queue_.tiles.back());
    queue_.tiles.pop_back();
    if (isOnItsWay(tile.id())) continue;
    Read read{nextNumber(), tile.id(), tile.info().strip};
    limit_.begin(read.extent.stored_bytes, now);
    begin(std::move(tile), read.number);
    addNeighbours(read, now);
    return read;
  }
  return std::nullopt;
}

// What lies beside the read, of what would be read soon anyway; each may have neighbours of its own. Where bytes are limited, nothing goes before what is more urgent.
void StripLoader::addNeighbours(Read& read, Clock::time_point now) {
  auto& tiles = queue_.tiles;
  const size_t looked_at = limit_.limits() ? 1 : kNextOfQueue;
  size_t strips = 1;
  for (size_t back = 1; back <= std::min(looked_at, tiles.size()) && strips < kStripsPerRead && limit_.lets(now); ++back) {
    const auto tile = tiles.end() - static_cast<std::ptrdiff_t>(back);
    const std::optional<formats::Extent> both = together(read.extent, tile->info().strip, shared_);
    if (!both || isOnItsWay(tile->id())) continue;
    limit_.begin(both->stored_bytes - read.extent.stored_bytes, now);
    read.extent = *both;
    begin(std::move(*tile), read.number);
    tiles.erase(tile);
    ++strips;
    back = 0;
  }
}

// Whoever made the queue did not know of arrivals after the queue_.taken-th.
bool StripLoader::isOnItsWay(TileId id) const {
  return std::ranges::any_of(since_taken_, [id](const auto& arrival) { return arrival.second == id; }) || std::ranges::find(under_way_, id, &UnderWay::id) != under_way_.end();
}

void StripLoader::begin(TileRef tile, uint32_t read) {
  under_way_.push_back({std::move(tile), Clock::now(), read});
  under_way_count_.fetch_add(1);
}

uint32_t StripLoader::nextNumber() {
  if (++last_read_ == 0) ++last_read_;
  return last_read_;
}

void StripLoader::countQueued() {
  if (queued_count_.exchange(queue_.size()) != queue_.size()) progress();
}

// All that are queued, as far as there is room.
std::span<ChildRef> StripLoader::nextChunks(std::span<ChildRef> room) {
  const std::lock_guard lock(pipeline_mutex_);
  size_t n = 0;
  while (n < room.size() && !stop_ && !queue_.chunks.empty() && arrived_chunk_count_.load() + chunks_under_way_.size() < kMaxArrivedChunks) {
    ChildRef request = std::move(queue_.chunks.back());
    queue_.chunks.pop_back();
    if (std::ranges::find(chunks_under_way_, request.id()) != chunks_under_way_.end()) continue;
    chunks_under_way_.push_back(request.id());
    under_way_count_.fetch_add(1);
    room[n++] = std::move(request);
  }
  countQueued();
  return room.first(n);
}

void StripLoader::readChunks(std::span<ChildRef> requests) {
  if (requests.size() > 1) world_.bringChildren(requests, {.cancelled = &cancel_reads_});
  for (ChildRef& request : requests) readChunk(std::exchange(request, {}));
}

void StripLoader::readChunk(const ChildRef& request) {
  Result<formats::ChunkPtr> chunk = Error{ErrorCode::kIo, "", "", kOutOfMemory, ""};
  try {
    chunk = world_.child(request.parent, request.child, {.cancelled = &cancel_reads_});
  } catch (const std::bad_alloc&) {  // also of the line that would say so
  }
  const std::lock_guard lock(pipeline_mutex_);
  if (!chunk) keepFailure(chunk.error());
  {
    const std::lock_guard hand_over_lock(hand_over_mutex_);
    arrived_chunks_.push_back({request.id(), chunk ? std::move(*chunk) : nullptr});
    arrived_chunk_count_.store(static_cast<uint32_t>(arrived_chunks_.size()));
  }
  std::erase(chunks_under_way_, request.id());
  under_way_count_.fetch_sub(1);
  progress();
}

std::optional<StripLoader::Stored> StripLoader::nextToDecode() {
  const std::lock_guard lock(pipeline_mutex_);
  if (to_decode_.empty() || stop_) return std::nullopt;
  std::optional<Stored> stored = std::move(to_decode_.front());
  to_decode_.pop_front();
  return stored;
}

void StripLoader::onRead(uint32_t number, Result<std::vector<std::byte>> bytes) {
  const std::lock_guard lock(pipeline_mutex_);
  const SharedRead shared = sharedRead(number);
  if (shared.strips > 1 && (!bytes || bytes->size() != shared.to - shared.from))
    readAlone(number);
  else if (!bytes)
    fail(std::ranges::find(under_way_, number, &UnderWay::read)->id(), bytes.error(), 0);
  else
    handOut(number, shared, std::move(*bytes));
  // A decoder starts the next read: this thread belongs to the source.
  wake();
  // Last, and under the lock: the destructor returns as soon as it sees no read.
  --reads_;
  reads_done_.notify_all();
}

StripLoader::SharedRead StripLoader::sharedRead(uint32_t number) const {
  SharedRead shared;
  for (const UnderWay& strip : under_way_) {
    if (strip.read != number) continue;
    const formats::Extent& extent = strip.tile.info().strip;
    shared.from = std::min(shared.from, extent.offset);
    shared.to = std::max(shared.to, extent.offset + extent.stored_bytes);
    shared.strip_bytes += extent.stored_bytes;
    ++shared.strips;
  }
  return shared;
}

// To the decoders, each strip's part. A strip that was alone gets what has come, whatever its size.
void StripLoader::handOut(uint32_t number, const SharedRead& shared, std::vector<std::byte> bytes) {
  gap_bytes_.fetch_add(shared.to - shared.from - shared.strip_bytes);
  std::shared_ptr<const std::vector<std::byte>> read;
  for (auto at = under_way_.begin(); (at = std::ranges::find(under_way_, number, &UnderWay::read)) != under_way_.end();) try {
      if (!read) read = std::make_shared<const std::vector<std::byte>>(std::move(bytes));
      const formats::Extent& extent = at->tile.info().strip;
      to_decode_.push_back({at->tile, read, shared.strips == 1 ? std::span(*read) : std::span(*read).subspan(extent.offset - shared.from, extent.stored_bytes)});
      stored_bytes_ += to_decode_.back().bytes.size();
      peak_stored_bytes_.store(std::max(peak_stored_bytes_.load(), stored_bytes_));
      at->read = 0;
    } catch (const std::bad_alloc&) {
      fail(at->id(), {ErrorCode::kIo, "", "", kOutOfMemory, ""}, 0);
    }
}

// What fails of several may be the fault of one.
void StripLoader::readAlone(uint32_t number) {
  for (UnderWay& strip : under_way_)
    if (strip.read == number) strip.read = 0, strip.alone = true;
}

void StripLoader::decode(const Stored& stored) {
  Result<StripPtr> strip = Error{ErrorCode::kIo, "", "", kOutOfMemory, ""};
  const auto began = std::chrono::steady_clock::now();
  try {
    strip = decodeAndPack(world_, stored.tile, stored.bytes, {.cancelled = &cancel_reads_});
  } catch (const std::bad_alloc&) {  // also of the line that would say so
  }
  decode_ns_.fetch_add(static_cast<uint64_t>(std::chrono::nanoseconds(std::chrono::steady_clock::now() - began).count()));
  const std::lock_guard lock(pipeline_mutex_);
  stored_bytes_ -= stored.bytes.size();
  if (strip)
    arrive(stored.tile.id(), std::move(*strip), stored.bytes.size());
  else
    fail(stored.tile.id(), strip.error(), stored.bytes.size());
}

void StripLoader::fail(TileId id, const Error& error, uint64_t stored_bytes) {
  keepFailure(error);
  arrive(id, nullptr, stored_bytes);
}

void StripLoader::keepFailure(const Error& error) {
  try {
    failure_ = error;
  } catch (const std::bad_alloc&) {
    failure_ = {ErrorCode::kIo, "", "", kOutOfMemory, ""};
  }
}

void StripLoader::arrive(TileId id, StripPtr strip, uint64_t stored_bytes) {
  {
    const std::lock_guard lock(hand_over_mutex_);
    arrived_.push_back({id, std::move(strip), stored_bytes});
    ++arrivals_;
    arrived_count_.store(static_cast<uint32_t>(arrived_.size()));
  }
  if (since_taken_.size() < since_taken_.capacity()) since_taken_.emplace_back(arrivals_, id);  // else it may be read twice
  const auto at = std::ranges::find(under_way_, id, &UnderWay::id);
  const float took = std::chrono::duration<float>(std::chrono::steady_clock::now() - at->since).count();
  latency_seconds_ = longestOfLate(latency_seconds_.load(), took);
  under_way_.erase(at);
  under_way_count_.fetch_sub(1);
  progress();
}

}  // namespace ff::stream
