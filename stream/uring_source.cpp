// Reads through io_uring. Axboe. Efficient IO with io_uring. 2019.
// Submissions come from any thread under a mutex; one thread takes completions and calls back. Past the ring's depth
// requests wait in order.
#include <liburing.h>

#include <deque>
#include <memory>
#include <mutex>
#include <thread>
#include <unordered_map>

#include "stream/file_request.h"
#include "stream/file_source.h"

namespace ff::stream {
namespace {

constexpr unsigned kRingEntries = 64;

class UringSource final : public TileSource {
 public:
  explicit UringSource(const formats::World& world) : world_(world) {}

  ~UringSource() override {
    if (!thread_.joinable()) return;
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
      if (in_flight_.empty()) submitWakeup();  // else the last completion ends the thread
    }
    thread_.join();
    io_uring_queue_exit(&ring_);
  }

  Result<void> start() {
    if (const int rc = io_uring_queue_init(kRingEntries, &ring_, 0); rc < 0) return refused("io_uring_queue_init", -rc);
    io_uring_probe* probe = io_uring_get_probe_ring(&ring_);
    const bool can_read = probe && io_uring_opcode_supported(probe, IORING_OP_READ);
    if (probe) io_uring_free_probe(probe);
    if (!can_read) {
      io_uring_queue_exit(&ring_);
      return refused("IORING_OP_READ", ENOSYS);
    }
    thread_ = std::thread([this] { complete(); });
    return {};
  }

  void read(formats::TileId id, Done done) override {
    auto item = std::make_unique<Item>(Item{FileRequest(world_, id), std::move(done)});
    const std::lock_guard lock(mutex_);
    waiting_.push_back(std::move(item));
    submitWaiting();
  }

  const char* name() const override { return "io_uring"; }

 private:
  struct Item {
    FileRequest request;
    Done done;
  };
  static constexpr uint64_t kWakeup = 0;  // user data of the request that ends the thread

  static Error refused(const char* what, int code) {
    return {ErrorCode::kIo, "", what, std::strerror(code), "reading with threads instead"};
  }

  // All three with mutex_ held.
  void submitWaiting() {
    while (!waiting_.empty() && in_flight_.size() < kRingEntries) {
      const uint64_t key = next_key_++;
      Item& item = *(in_flight_[key] = std::move(waiting_.front()));
      waiting_.pop_front();
      submitRead(key, item);
    }
  }
  void submitRead(uint64_t key, Item& item) {
    // There is always an entry: in flight at most kRingEntries, and each is submitted at once.
    io_uring_sqe* entry = io_uring_get_sqe(&ring_);
    const std::span<std::byte> rest = item.request.remaining();
    io_uring_prep_read(entry, item.request.descriptor(), rest.data(), static_cast<unsigned>(rest.size()),
                       item.request.offset());
    io_uring_sqe_set_data64(entry, key);
    submitAll();
  }
  void submitWakeup() {
    io_uring_sqe* entry = io_uring_get_sqe(&ring_);
    io_uring_prep_nop(entry);
    io_uring_sqe_set_data64(entry, kWakeup);
    submitAll();
  }
  void submitAll() {
    for (int rc; (rc = io_uring_submit(&ring_)) < 0;)
      if (rc != -EINTR && rc != -EAGAIN && rc != -EBUSY) FF_CHECK_EQ(rc, 0);
  }

  void complete() {
    for (;;) {
      io_uring_cqe* completion = nullptr;
      if (const int rc = io_uring_wait_cqe(&ring_, &completion); rc < 0) {
        FF_CHECK_EQ(rc, -EINTR);
        continue;
      }
      const uint64_t key = io_uring_cqe_get_data64(completion);
      const int outcome = completion->res;
      io_uring_cqe_seen(&ring_, completion);
      if (key == kWakeup) return;
      std::unique_ptr<Item> item = advance(key, outcome);
      if (item) {
        item->done(item->request.id(), item->request.take());
        if (lastOne()) return;
      }
    }
  }

  // The finished item, or null while it goes on. Locking also orders the submitter's writes before this thread's reads.
  std::unique_ptr<Item> advance(uint64_t key, int outcome) {
    const std::lock_guard lock(mutex_);
    auto found = in_flight_.find(key);
    Item& item = *found->second;
    if (outcome != -EINTR && outcome != -EAGAIN) item.request.advance(outcome);
    if (!item.request.finished()) {
      submitRead(key, item);
      return nullptr;
    }
    std::unique_ptr<Item> finished = std::move(found->second);
    in_flight_.erase(found);
    submitWaiting();
    return finished;
  }

  bool lastOne() {
    const std::lock_guard lock(mutex_);
    return stop_ && in_flight_.empty();
  }

  const formats::World& world_;
  io_uring ring_{};
  std::mutex mutex_;
  std::unordered_map<uint64_t, std::unique_ptr<Item>> in_flight_;
  std::deque<std::unique_ptr<Item>> waiting_;
  uint64_t next_key_ = 1;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace

Result<std::unique_ptr<TileSource>> makeUringSource(const formats::World& world) {
  for (const formats::ShardInfo& shard : world.shards())
    if (shard.descriptor < 0) return Error{ErrorCode::kIo, shard.name, "io_uring", "the world's storage has no descriptors", "read with threads"};
  auto source = std::make_unique<UringSource>(world);
  if (auto started = source->start(); !started) return started.error();
  return std::unique_ptr<TileSource>(std::move(source));
}

}  // namespace ff::stream
