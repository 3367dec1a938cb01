// What the baselines on the CPU have in common: one matrix of columns, the colours of its places, who sits where, and the
// clock.
#pragma once
#include <algorithm>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "runtime/clock.h"
#include "runtime/dense/page_memory.h"
#include "runtime/dense/places.h"

namespace ff::runtime {

template <class Element>
class CpuBaseline : public BounceMatrix {
 public:
  bool allocated() const { return static_cast<bool>(matrix_); }
  uint32_t capacity() const override { return places_.capacity(); }
  uint64_t bytes() const override { return uint64_t{stride_} * rows_ * sizeof(Element); }
  BounceStats stats() const override { return stats_; }
  Result<uint32_t> advance(uint32_t) override { return 0u; }

  Result<void> insert(const EnteringBlock& block) override {
    const auto start = Clock::now();
    if (auto sound = checkFormFactors(block); !sound) return sound;
    for (uint32_t r = 0; r < block.places.size(); ++r) {
      places_.take(block.places[r]);
      enter(block, r);
      colour_[block.places[r]] = block.albedo[r];
    }
    stats_.entered += block.places.size();
    stats_.last_update_ms = msSince(start);
    return {};
  }

  // "Delete operation is implemented by zeroing the row and column of the matrix".
  Result<void> remove(std::span<const uint32_t> places) override {
    const auto start = Clock::now();
    for (const uint32_t p : places) {
      zeroPlace(matrix_.data(), stride_, places_.used(), p);
      colour_[p] = {};
      places_.give(p);
    }
    stats_.left += places.size();
    stats_.last_update_ms = msSince(start);
    return {};
  }

  Result<void> clear() override {
    std::memset(static_cast<void*>(matrix_.data()), 0, size_t{stride_} * places_.used() * sizeof(Element));
    std::fill(colour_.begin(), colour_.end(), Vec4{});
    places_.clear();
    return {};
  }

  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    places_.checkLight(source, irradiance);
    light(source, irradiance);
    stats_.last_relight_ms = msSince(start);
    return {};
  }

  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    places_.checkChange(places, difference, irradiance);
    addLight(places, difference, irradiance);
    stats_.last_relight_ms = msSince(start);
    return {};
  }

 protected:
  // Kernels take that many rows at once.
  CpuBaseline(const MultibounceSettings& settings, uint32_t rows_together)
      : places_(settings.places),
        rows_((settings.places + rows_together - 1) / rows_together * rows_together),
        stride_(rows_ + rows_together),  // no power of two: columns would share the same few sets of the caches
        matrix_(stride_ * rows_),
        colour_(rows_) {}

  // Patch r of a block, whose place is taken and has no colour yet.
  virtual void enter(const EnteringBlock& block, uint32_t r) = 0;
  virtual void light(std::span<const Vec4> source, std::span<Vec4> irradiance) = 0;
  virtual void addLight(std::span<const uint32_t> places, std::span<const Vec4> difference, std::span<Vec4> irradiance) = 0;

  Element* column(uint32_t place) { return matrix_.data() + place * stride_; }

  Places places_;
  uint32_t rows_;
  size_t stride_;
  PageMemory<Element> matrix_;
  std::vector<Vec4> colour_;  // per place, 0 where free

 private:
  BounceStats stats_;
};

// Errors (kUsage): a number of places that no matrix has; too little memory, with the remedy.
template <class Matrix, class... Arguments>
Result<std::unique_ptr<BounceMatrix>> makeCpuBaseline(const std::string& remedy, const MultibounceSettings& settings,
                                                      Arguments... arguments) {
  if (auto sound = checkPlaces(settings.places); !sound) return sound.error();
  auto matrix = std::make_unique<Matrix>(settings, arguments...);
  if (!matrix->allocated()) return tooLittleMemory(settings.places, remedy);
  return std::unique_ptr<BounceMatrix>(std::move(matrix));
}

}  // namespace ff::runtime
