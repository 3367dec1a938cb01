// Reads through io_uring. Axboe. Efficient IO with io_uring. 2019.
// Submissions come from any thread under a mutex; one thread takes completions and calls back. Past the ring's depth
// requests wait in order. Should the kernel refuse the ring later on, that thread reads itself.
#include <liburing.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>

#include "stream/file_request.h"
#include "stream/file_source.h"
#include "stream/start_threads.h"

namespace ff::stream {
namespace {

constexpr unsigned kRingEntries = 64;
constexpr int kSubmitTries = 1000;  // where the kernel is out of memory for the moment; then it counts as refusing the ring

class UringSource final : public TileSource {
 public:
  explicit UringSource(const formats::World& world) : world_(world), random_(world) {}

  ~UringSource() override {
    if (!thread_.joinable()) return;
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_one();
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
    try {
      thread_ = startThread([this] { complete(); });
    } catch (const std::system_error& e) {
      io_uring_queue_exit(&ring_);
      return refused("thread", e.code().value());
    }
    return {};
  }

  void read(formats::TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) override {
    auto item = std::make_unique<Item>(Item{FileRequest(world_, id, extent, options, random_), std::move(done)});
    const std::lock_guard lock(mutex_);
    waiting_.push_back(std::move(item));
    submitWaiting();
  }

  SharedReads sharedReads() const override { return kLocalReads; }
  int readsAtOnce() const override { return kRingEntries; }
  const char* name() const override { return "io_uring"; }

 private:
  struct Item {
    FileRequest request;
    Done done;
    bool submitted = false;  // the kernel has it
  };

  static Error refused(const char* what, int code) {
    return {ErrorCode::kIo, "", what, std::strerror(code), "reading with threads instead"};
  }

  // All with mutex_ held. They need no memory.
  bool anyLeft() const {
    return !waiting_.empty() || std::any_of(in_flight_.begin(), in_flight_.end(), [](const auto& item) { return item != nullptr; });
  }
  void submitWaiting() {
    for (size_t place = 0; place < kRingEntries && !waiting_.empty() && !broken_; ++place) {
      if (in_flight_[place]) continue;
      in_flight_[place] = std::move(waiting_.front());
      waiting_.pop_front();
      submitRead(place);
    }
    wake_.notify_one();
  }
  // Where it ends now, or the kernel does not take it, the item stays for takeLeft().
  void submitRead(size_t place) {
    Item& item = *in_flight_[place];
    if (item.request.endsNow()) {
      ++ended_;
      return;
    }
    // There is always an entry: in flight at most kRingEntries, and each is submitted at once.
    io_uring_sqe* entry = io_uring_get_sqe(&ring_);
    const std::span<std::byte> rest = item.request.remaining();
    io_uring_prep_read(entry, item.request.descriptor(), rest.data(), static_cast<unsigned>(rest.size()), item.request.offset());
    io_uring_sqe_set_data64(entry, place);
    int rc = -EAGAIN;
    for (int tries = 0; tries < kSubmitTries && (rc == -EINTR || rc == -EAGAIN || rc == -EBUSY); ++tries) rc = io_uring_submit(&ring_);
    item.submitted = rc >= 0;
    submitted_ += item.submitted;
    broken_ = broken_ || rc < 0;
  }

  void complete() {
    for (;;) {
      std::unique_ptr<Item> item;
      {
        std::unique_lock lock(mutex_);
        wake_.wait(lock, [this] { return submitted_ + ended_ > 0 || (broken_ && anyLeft()) || (stop_ && !anyLeft()); });
        if (submitted_ == 0 && !anyLeft()) return;
        if (ended_ > 0 || submitted_ == 0) item = takeLeft();
      }
      if (item) {
        readItself(item->request);
        answer(*item);
        continue;
      }
      io_uring_cqe* completion = nullptr;
      if (const int rc = io_uring_wait_cqe(&ring_, &completion); rc < 0) {
        if (rc != -EINTR) giveUp(-rc);
        continue;
      }
      const auto place = static_cast<size_t>(io_uring_cqe_get_data64(completion));
      const int outcome = completion->res;
      io_uring_cqe_seen(&ring_, completion);
      if (const std::unique_ptr<Item> finished = advance(place, outcome)) answer(*finished);
    }
  }

  static void answer(Item& item) {
    Result<std::vector<std::byte>> bytes = Error{ErrorCode::kIo, "", "", "out of memory", ""};
    try {
      bytes = item.request.take();
    } catch (const std::bad_alloc&) {  // for the line of an error
    }
    item.done(item.request.id(), std::move(bytes));
  }

  // What the kernel has nothing to do with, with mutex_ held: there is some.
  std::unique_ptr<Item> takeLeft() {
    for (auto& place : in_flight_)
      if (place && !place->submitted) {
        std::unique_ptr<Item> item = std::move(place);
        ended_ -= item->request.finished();
        submitWaiting();
        return item;
      }
    std::unique_ptr<Item> item = std::move(waiting_.front());
    waiting_.pop_front();
    return item;
  }
  static void readItself(FileRequest& request) {
    while (!request.endsNow()) {
      const std::span<std::byte> rest = request.remaining();
      const ssize_t n = ::pread(request.descriptor(), rest.data(), rest.size(), static_cast<off_t>(request.offset()));
      if (n >= 0 || errno != EINTR) request.advance(n >= 0 ? n : -errno);
    }
  }

  // Completions cannot be had any more. The kernel may still write to what it was given: that memory is never used again.
  void giveUp(int code) {
    std::array<std::unique_ptr<Item>, kRingEntries> lost;
    {
      const std::lock_guard lock(mutex_);
      broken_ = true;
      submitted_ = 0;
      for (size_t place = 0; place < kRingEntries; ++place)
        if (in_flight_[place] && in_flight_[place]->submitted) lost[place] = std::move(in_flight_[place]);
    }
    for (auto& item : lost) {
      if (!item) continue;
      item->request.advance(-code);
      answer(*item);
      (void)item.release();
    }
  }

  // The finished item, or null while it goes on. Locking also orders the submitter's writes before this thread's reads.
  std::unique_ptr<Item> advance(size_t place, int outcome) {
    const std::lock_guard lock(mutex_);
    Item& item = *in_flight_[place];
    item.submitted = false;
    --submitted_;
    if (outcome != -EINTR && outcome != -EAGAIN) item.request.advance(outcome);
    if (!item.request.finished()) {
      if (!broken_) submitRead(place);
      return nullptr;
    }
    std::unique_ptr<Item> finished = std::move(in_flight_[place]);
    submitWaiting();
    return finished;
  }

  const formats::World& world_;
  RandomReads random_;
  io_uring ring_{};
  std::mutex mutex_;
  std::condition_variable wake_;
  std::array<std::unique_ptr<Item>, kRingEntries> in_flight_;  // by the user data of the kernel's requests
  std::deque<std::unique_ptr<Item>> waiting_;
  uint32_t submitted_ = 0, ended_ = 0;  // of in_flight_: what the kernel has; what is over and not answered yet
  bool stop_ = false, broken_ = false;
  std::thread thread_;
};

}  // namespace

Result<std::unique_ptr<TileSource>> makeUringSource(const formats::World& world) {
  // Storage has descriptors for all of its files or for none.
  auto descriptor = world.descriptor(0);
  if (!descriptor) return descriptor.error();
  if (*descriptor < 0) return Error{ErrorCode::kIo, world.shards()[0].name, "io_uring", "the world's storage has no descriptors", "read with threads"};
  auto source = std::make_unique<UringSource>(world);
  if (auto started = source->start(); !started) return started.error();
  return std::unique_ptr<TileSource>(std::move(source));
}

}  // namespace ff::stream
