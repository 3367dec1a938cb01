#include "stream/file_source.h"

#include <condition_variable>
#include <deque>
#include <mutex>
#include <new>
#include <thread>

#include "stream/file_request.h"
#include "stream/start_threads.h"

namespace ff::stream {
namespace {

constexpr int kThreads = 4, kRemoteThreads = 16;
constexpr int kReadsAtOnce = 16;  // four for each local thread, so that none of these waits for the next; one for each remote one
// Over a network a read costs a round trip, and the cache brings whole pieces of 64 KiB anyway.
constexpr SharedReads kRemoteReads{.gap_bytes = 32 << 10, .max_bytes = 128 << 10, .strips_per_read = 4};

class ThreadSource final : public TileSource {
 public:
  ThreadSource(const formats::World& world, int threads, SharedReads shared) : world_(world), shared_(shared), random_(world) {
    startThreads(threads_, std::max(threads, 1), [this] { work(); });
  }

  ~ThreadSource() override {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }

  void read(formats::TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) override {
    {
      const std::lock_guard lock(mutex_);
      queue_.push_back({id, extent, options, std::move(done)});
    }
    wake_.notify_one();
  }

  SharedReads sharedReads() const override { return shared_; }
  int readsAtOnce() const override { return kReadsAtOnce; }
  const char* name() const override { return "threads"; }

 private:
  struct Item {
    formats::TileId id;
    formats::Extent extent;
    formats::ReadOptions options;
    Done done;
  };

  void work() {
    for (;;) {
      Item item;
      {
        std::unique_lock lock(mutex_);
        wake_.wait(lock, [this] { return stop_ || !queue_.empty(); });
        if (queue_.empty()) return;
        item = std::move(queue_.front());
        queue_.pop_front();
      }
      item.done(item.id, readBlocking(item.extent, item.options));
    }
  }

  Result<std::vector<std::byte>> readBlocking(const formats::Extent& extent, const formats::ReadOptions& options) try {
    random_.expect(extent.shard, world_.descriptor(extent.shard, options));
    std::vector<std::byte> bytes(extent.stored_bytes);
    if (auto ok = world_.readStored(extent, bytes, options); !ok) return ok.error();
    return bytes;
  } catch (const std::bad_alloc&) {
    return Error{ErrorCode::kIo, "", "", "out of memory", ""};
  }

  const formats::World& world_;
  const SharedReads shared_;
  RandomReads random_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Item> queue_;
  bool stop_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace

std::unique_ptr<TileSource> makeThreadSource(const formats::World& world, int threads, SharedReads shared) {
  return std::make_unique<ThreadSource>(world, threads, shared);
}

std::unique_ptr<TileSource> makeFileSource(const formats::World& world) {
  if (auto uring = makeUringSource(world)) return std::move(*uring);
  // What has no descriptors may lie behind a network: a thread for each read that waits for it.
  const auto descriptor = world.descriptor(0);
  const bool remote = descriptor && *descriptor < 0;
  return makeThreadSource(world, remote ? kRemoteThreads : kThreads, remote ? kRemoteReads : kLocalReads);
}

}  // namespace ff::stream
