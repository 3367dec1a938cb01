#include "stream/strip_loader.h"

#include <algorithm>
#include <new>
#include <utility>

#include "stream/start_threads.h"

namespace ff::stream {

using formats::TileId;

namespace {

// Counters may wrap.
bool isAfter(uint32_t a, uint32_t b) { return static_cast<int32_t>(a - b) > 0; }

constexpr const char* kOutOfMemory = "out of memory";  // short enough for a string to need none

}  // namespace

Result<StripPtr> decodeAndPack(const formats::World& world, TileId id, std::span<const std::byte> stored) {
  formats::Strip strip;
  if (auto decoded = world.decodeStrip(id, stored, strip); !decoded) return decoded.error();
  auto packed = pack(std::move(strip));
  if (!packed) return packed.error();
  return std::make_shared<const ResidentStrip>(std::move(*packed));
}

StripLoader::StripLoader(const formats::World& world, TileSource& source, int depth, int decode_threads,
                         size_t most_queued, size_t most_retired)
    : world_(world),
      source_(source),
      depth_(static_cast<size_t>(std::max(depth, 1))) {
  // Lists change places when they are handed over, so each has room for the most that any of them can hold.
  for (std::vector<TileId>* list : {&next_queue_, &submitted_, &incoming_, &queue_, &sorted_}) list->reserve(most_queued);
  const size_t most_arrived = 5 * depth_;  // 4 * depth_ that wait, and what was under way then
  for (std::vector<Arrival>* list : {&taken_, &arrived_}) list->reserve(most_arrived);
  for (std::vector<StripPtr>* list : {&next_retired_, &submitted_retired_, &incoming_retired_})
    list->reserve(most_retired + 2 * most_arrived);
  under_way_.reserve(depth_);
  since_taken_.reserve(4 * most_arrived);
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
  {
    const std::lock_guard lock(hand_over_mutex_);
    submitted_.swap(next_queue_);
    submitted_taken_ = taken_count_;
    fresh_ = true;
    if (submitted_retired_.empty()) submitted_retired_.swap(next_retired_);
    submitted_count_.store(static_cast<uint32_t>(submitted_.size()));
  }
  next_queue_.clear();
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

StripLoader::Backlog StripLoader::backlog() const {
  Backlog backlog;
  backlog.queued = submitted_count_.load();
  backlog.queued += queued_count_.load();
  backlog.under_way = under_way_count_.load();
  backlog.arrived = arrived_count_.load();
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
  for (;;) {
    const uint32_t seen = wake_.load();
    pickUp();
    startReads();
    if (const std::optional<Stored> stored = nextToDecode()) {
      decode(*stored);
      continue;
    }
    {
      const std::lock_guard lock(pipeline_mutex_);
      if (stop_) return;
    }
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
      submitted_.swap(incoming_);
      queue_taken_ = submitted_taken_;
      queued_count_.store(static_cast<uint32_t>(incoming_.size()));
      submitted_count_.store(0);
    }
  }
  freeRetired();
  if (!fresh) return;
  std::erase_if(since_taken_, [this](const auto& arrival) { return !isAfter(arrival.first, queue_taken_); });
  sorted_.assign(incoming_.begin(), incoming_.end());
  std::ranges::sort(sorted_);
  cancelled_.fetch_add(static_cast<uint64_t>(std::ranges::count_if(queue_, [this](TileId id) { return !std::ranges::binary_search(sorted_, id); })));
  queue_.swap(incoming_);
  incoming_.clear();
  progress();
}

// Nobody can come to share a strip that the list alone holds, so a count of 1 stays.
void StripLoader::freeRetired() {
  for (StripPtr& strip : incoming_retired_) try {
      retired_.push_back(std::move(strip));
    } catch (const std::bad_alloc&) {  // whoever holds it last frees it
    }
  incoming_retired_.clear();
  std::erase_if(retired_, [](const StripPtr& strip) { return strip.use_count() == 1; });
}

void StripLoader::startReads() {
  while (const std::optional<TileId> id = nextRead()) try {
      source_.read(*id, {.cancelled = &cancel_reads_}, [this](TileId done, Result<std::vector<std::byte>> bytes) { onRead(done, std::move(bytes)); });
    } catch (const std::bad_alloc&) {
      onRead(*id, Error{ErrorCode::kIo, "", "", kOutOfMemory, ""});
    }
}

std::optional<TileId> StripLoader::nextRead() {
  const std::lock_guard lock(pipeline_mutex_);
  std::optional<TileId> found;
  while (!found && !stop_ && !queue_.empty() && under_way_count_.load() < depth_ && arrived_count_.load() < 4 * depth_) {
    const TileId id = queue_.back();
    queue_.pop_back();
    // Whoever made the queue did not know of arrivals after the queue_taken_-th.
    const bool arrived = std::ranges::any_of(since_taken_, [id](const auto& arrival) { return arrival.second == id; });
    if (!arrived && std::ranges::find(under_way_, id) == under_way_.end()) found = id;
  }
  if (found) {
    under_way_.push_back(*found);
    under_way_count_.fetch_add(1);
    ++reads_;
  }
  if (queued_count_.exchange(static_cast<uint32_t>(queue_.size())) != queue_.size()) progress();
  return found;
}

std::optional<StripLoader::Stored> StripLoader::nextToDecode() {
  const std::lock_guard lock(pipeline_mutex_);
  if (to_decode_.empty() || stop_) return std::nullopt;
  std::optional<Stored> stored = std::move(to_decode_.front());
  to_decode_.pop_front();
  return stored;
}

void StripLoader::onRead(TileId id, Result<std::vector<std::byte>> bytes) {
  const std::lock_guard lock(pipeline_mutex_);
  if (!bytes) {
    fail(id, bytes.error(), 0);
  } else try {
    to_decode_.push_back({id, std::move(*bytes)});
  } catch (const std::bad_alloc&) {
    fail(id, {ErrorCode::kIo, "", "", kOutOfMemory, ""}, 0);
  }
  // A decoder starts the next read: this thread belongs to the source.
  wake();
  // Last, and under the lock: the destructor returns as soon as it sees no read.
  --reads_;
  reads_done_.notify_all();
}

void StripLoader::decode(const Stored& stored) {
  Result<StripPtr> strip = Error{ErrorCode::kIo, "", "", kOutOfMemory, ""};
  try {
    strip = decodeAndPack(world_, stored.id, stored.bytes);
  } catch (const std::bad_alloc&) {  // also of the line that would say so
  }
  const std::lock_guard lock(pipeline_mutex_);
  if (strip)
    arrive(stored.id, std::move(*strip), stored.bytes.size());
  else
    fail(stored.id, strip.error(), stored.bytes.size());
}

void StripLoader::fail(TileId id, const Error& error, uint64_t stored_bytes) {
  try {
    failure_ = error;
  } catch (const std::bad_alloc&) {
    failure_ = {ErrorCode::kIo, "", "", kOutOfMemory, ""};
  }
  arrive(id, nullptr, stored_bytes);
}

void StripLoader::arrive(TileId id, StripPtr strip, uint64_t stored_bytes) {
  {
    const std::lock_guard lock(hand_over_mutex_);
    arrived_.push_back({id, std::move(strip), stored_bytes});
    ++arrivals_;
    arrived_count_.store(static_cast<uint32_t>(arrived_.size()));
  }
  if (since_taken_.size() < since_taken_.capacity()) since_taken_.emplace_back(arrivals_, id);  // else it may be read twice
  std::erase(under_way_, id);
  under_way_count_.fetch_sub(1);
  progress();
}

}  // namespace ff::stream
