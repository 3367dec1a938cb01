// Which places of a dense matrix are taken, and what all such matrices check of their callers.
#pragma once
#include <algorithm>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "formats/result.h"
#include "runtime/dense/bounce_matrix.h"

namespace ff::runtime {

class Places {
 public:
  explicit Places(uint32_t capacity) : capacity_(capacity), taken_(capacity, 0) {}

  uint32_t capacity() const { return capacity_; }
  uint32_t used() const { return used_; }  // one past the highest place taken
  bool taken(uint32_t place) const { return taken_[place] != 0; }

  void take(uint32_t place) {
    FF_CHECK_LT(place, capacity_);
    FF_CHECK_EQ(int{taken_[place]}, 0);
    taken_[place] = 1;
    used_ = std::max(used_, place + 1);
  }
  void give(uint32_t place) {
    FF_CHECK_LT(place, capacity_);
    FF_CHECK_EQ(int{taken_[place]}, 1);
    taken_[place] = 0;
    while (used_ > 0 && taken_[used_ - 1] == 0) --used_;
  }
  void clear() {
    std::fill(taken_.begin(), taken_.end(), uint8_t{0});
    used_ = 0;
  }

  void checkLight(std::span<const Vec4> source, std::span<const Vec4> irradiance) const {
    FF_CHECK_EQ(source.size(), size_t{capacity_});
    FF_CHECK_EQ(irradiance.size(), size_t{capacity_});
  }
  void checkChange(std::span<const uint32_t> places, std::span<const Vec4> difference,
                   std::span<const Vec4> irradiance) const {
    FF_CHECK_EQ(places.size(), difference.size());
    FF_CHECK_LE(places.size(), size_t{capacity_});
    FF_CHECK_EQ(irradiance.size(), size_t{capacity_});
  }

 private:
  uint32_t capacity_, used_ = 0;
  std::vector<uint8_t> taken_;
};

// Row and column of a place to zero.
template <class Element>
void zeroPlace(Element* matrix, size_t column_stride, uint32_t used, uint32_t place) {
  std::fill_n(matrix + place * column_stride, column_stride, Element{});
  for (uint32_t column = 0; column < used; ++column) matrix[column * column_stride + place] = Element{};
}

// Errors (kInvalidFile): a form factor that is none.
inline Result<void> checkFormFactors(const EnteringBlock& block) {
  if (hasValidFormFactors(block)) return {};
  return Error{ErrorCode::kInvalidFile, "", "", "a form factor is not a finite number >= 0", ""};
}

// Errors (kUsage): a number of places that no matrix has.
inline Result<void> checkPlaces(uint32_t places) {
  if (places > 0 && places <= kMaxPlaces) return {};
  return Error{ErrorCode::kUsage, "", "", "a dense matrix has 1 to " + std::to_string(kMaxPlaces) + " places", ""};
}
inline Error tooLittleMemory(uint32_t places, std::string remedy) {
  return Error{ErrorCode::kUsage, "", "", "not enough memory for a matrix of " + std::to_string(places) + " places",
               std::move(remedy)};
}

}  // namespace ff::runtime
