#include "runtime/dense/small_inverse.h"

#include <algorithm>
#include <cmath>

namespace ff::runtime {

bool invert(SmallMatrix& a, uint32_t k, SmallMatrix& inverse) {
  for (uint32_t i = 0; i < k; ++i)
    for (uint32_t j = 0; j < k; ++j) inverse(i, j) = i == j ? 1 : 0;
  for (uint32_t c = 0; c < k; ++c) {
    uint32_t pivot = c;
    for (uint32_t i = c + 1; i < k; ++i)
      if (std::abs(a(i, c)) > std::abs(a(pivot, c))) pivot = i;
    const double largest = a(pivot, c);
    if (!std::isfinite(largest) || largest == 0) return false;
    if (pivot != c)
      for (uint32_t j = 0; j < k; ++j) {
        std::swap(a(c, j), a(pivot, j));
        std::swap(inverse(c, j), inverse(pivot, j));
      }
    for (uint32_t j = 0; j < k; ++j) {
      a(c, j) /= largest;
      inverse(c, j) /= largest;
    }
    for (uint32_t i = 0; i < k; ++i) {
      const double factor = i == c ? 0 : a(i, c);
      if (factor == 0) continue;
      for (uint32_t j = 0; j < k; ++j) {
        a(i, j) -= factor * a(c, j);
        inverse(i, j) -= factor * inverse(c, j);
      }
    }
  }
  return true;
}

void multiply(const SmallMatrix& a, const SmallMatrix& b, uint32_t k, SmallMatrix& out) {
  for (uint32_t i = 0; i < k; ++i) {
    for (uint32_t j = 0; j < k; ++j) out(i, j) = 0;
    for (uint32_t m = 0; m < k; ++m)
      for (uint32_t j = 0; j < k; ++j) out(i, j) += a(i, m) * b(m, j);
  }
}

double rowNorm(const SmallMatrix& a, uint32_t k) {
  double norm = 0;
  for (uint32_t i = 0; i < k; ++i) {
    double sum = 0;
    for (uint32_t j = 0; j < k; ++j) sum += std::abs(a(i, j));
    norm = std::isfinite(sum) ? std::max(norm, sum) : sum;
    if (!std::isfinite(sum)) break;
  }
  return norm;
}

}  // namespace ff::runtime
