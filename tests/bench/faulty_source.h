// A source whose reads fail and bring damaged bytes now and then, by chance, and all of them in outages.
#pragma once
#include <atomic>
#include <memory>
#include <mutex>
#include <random>

#include "stream/tile_source.h"

namespace ff::bench {

struct Faults {
  std::atomic<bool> on{false}, outage{false};
  std::atomic<uint64_t> errors{0}, damaged{0};
};

class FaultySource final : public stream::TileSource {
 public:
  // faults: outlives the source.
  FaultySource(std::unique_ptr<TileSource> below, Faults& faults, uint64_t seed) : below_(std::move(below)), faults_(faults), random_(seed) {}
  void read(formats::TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) override {
    const double drawn = draw();
    const bool fails = faults_.on && (faults_.outage || drawn < kErrors), damaged = faults_.on && !fails && drawn < kErrors + kDamaged;
    faults_.errors += fails;
    faults_.damaged += damaged;
    below_->read(id, extent, options, [fails, damaged, done = std::move(done)](formats::TileId of, Result<std::vector<std::byte>> bytes) {
      if (fails) bytes = Error{ErrorCode::kIo, "", "", "a fault of the soak", ""};
      if (damaged && bytes && !bytes->empty()) (*bytes)[bytes->size() / 2] ^= std::byte{0x10};
      done(of, std::move(bytes));
    });
  }
  stream::SharedReads sharedReads() const override { return below_->sharedReads(); }
  int readsAtOnce() const override { return below_->readsAtOnce(); }
  const char* name() const override { return "faulty"; }

 private:
  static constexpr double kErrors = 0.02, kDamaged = 0.005;
  double draw() {
    const std::lock_guard lock(mutex_);
    return static_cast<double>(random_() >> 11) * 0x1p-53;
  }
  std::unique_ptr<TileSource> below_;
  Faults& faults_;
  std::mutex mutex_;
  std::mt19937_64 random_;
};

}  // namespace ff::bench
