// Inverses of matrices of at most kMaxBlock rows in double precision: what a block update needs. No allocation.
#pragma once
#include <array>
#include <cstdint>

#include "runtime/dense/bounce_matrix.h"

namespace ff::runtime {

// Row-major, rows of kMaxBlock.
struct SmallMatrix {
  std::array<double, size_t{kMaxBlock} * kMaxBlock> at{};
  double& operator()(uint32_t i, uint32_t j) { return at[size_t{i} * kMaxBlock + j]; }
  double operator()(uint32_t i, uint32_t j) const { return at[size_t{i} * kMaxBlock + j]; }
};

// inverse = a^-1 of the first k rows and columns, by Gauss-Jordan elimination with partial pivoting; a is destroyed.
// False where a pivot is zero or not finite.
bool invert(SmallMatrix& a, uint32_t k, SmallMatrix& inverse);

// out = a b.
void multiply(const SmallMatrix& a, const SmallMatrix& b, uint32_t k, SmallMatrix& out);

// The largest sum of magnitudes of a row.
double rowNorm(const SmallMatrix& a, uint32_t k);

}  // namespace ff::runtime
