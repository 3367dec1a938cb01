#include "runtime/dense/bounce_kernels.h"

#if defined(__x86_64__)
#include <immintrin.h>

#define FF_AVX2 __attribute__((target("avx2,fma,f16c")))

namespace ff::runtime {
namespace {

constexpr uint32_t kP = kPanelRows;
constexpr uint32_t kTileColumns = 6;  // 6 x 16 sums fill 12 of 16 registers

FF_AVX2 inline __m256 load8(const float* p) { return _mm256_loadu_ps(p); }
FF_AVX2 inline __m256 load8(const Half* p) {
  return _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(p)));
}
FF_AVX2 inline void store8(float* p, __m256 value) { _mm256_storeu_ps(p, value); }
FF_AVX2 inline void store8(Half* p, __m256 value) {
  _mm_storeu_si128(reinterpret_cast<__m128i*>(p), _mm256_cvtps_ph(value, _MM_FROUND_TO_NEAREST_INT));
}

// Rows x Columns of the product. While a tile is summed, the same rows of the columns to come are fetched: the
// processor's own prefetching does not see that far.
template <uint32_t Columns, class Element>
FF_AVX2 inline void addTile(const float* a, uint32_t k, const float* b, Element* matrix, size_t column_stride,
                            uint32_t row_begin, uint32_t row_end, bool more) {
  const __m256 scale = _mm256_set1_ps(kStoredScale<Element>);
  for (uint32_t row = row_begin; row < row_end; row += kP) {
    const float* panel = a + panelIndex(row, 0);
    Element* at = matrix + row;
    if (more)
      for (uint32_t n = 0; n < Columns; ++n)
        _mm_prefetch(reinterpret_cast<const char*>(at + (Columns + n) * column_stride), _MM_HINT_T0);
    __m256 low[Columns], high[Columns];
#pragma GCC unroll 6
    for (uint32_t n = 0; n < Columns; ++n) low[n] = high[n] = _mm256_setzero_ps();
    for (uint32_t p = 0; p < k; ++p) {
      const __m256 a0 = _mm256_loadu_ps(panel + p * kP), a1 = _mm256_loadu_ps(panel + p * kP + 8);
#pragma GCC unroll 6
      for (uint32_t n = 0; n < Columns; ++n) {
        const __m256 factor = _mm256_broadcast_ss(b + n * kFactorStride + p);
        low[n] = _mm256_fmadd_ps(a0, factor, low[n]);
        high[n] = _mm256_fmadd_ps(a1, factor, high[n]);
      }
    }
#pragma GCC unroll 6
    for (uint32_t n = 0; n < Columns; ++n) {
      Element* to = at + n * column_stride;
      store8(to, _mm256_fmadd_ps(low[n], scale, load8(to)));
      store8(to + 8, _mm256_fmadd_ps(high[n], scale, load8(to + 8)));
    }
  }
}

template <class Element>
FF_AVX2 void addProduct(const float* a, uint32_t k, const float* b, Element* matrix, size_t column_stride,
                        uint32_t row_begin, uint32_t row_end, uint32_t columns) {
  for (; columns >= kTileColumns; columns -= kTileColumns) {
    addTile<kTileColumns>(a, k, b, matrix, column_stride, row_begin, row_end, columns >= 2 * kTileColumns);
    b += kTileColumns * kFactorStride;
    matrix += kTileColumns * column_stride;
  }
  for (; columns >= 2; columns -= 2) {
    addTile<2>(a, k, b, matrix, column_stride, row_begin, row_end, false);
    b += 2 * kFactorStride;
    matrix += 2 * column_stride;
  }
  if (columns > 0) addTile<1>(a, k, b, matrix, column_stride, row_begin, row_end, false);
}

// `next`: so many columns again, which are fetched meanwhile: the processor's own prefetching starts anew with each
// column. To the second-level cache, since the first cannot keep eight columns.
template <uint32_t Columns, uint32_t Results, class Element>
FF_AVX2 inline void addSome(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                            const uint32_t* columns, const uint32_t* next, const float* const* factors,
                            float* const* out) {
  const Element *column[Columns], *ahead[Columns];
  __m256 factor[Results][Columns];
  for (uint32_t n = 0; n < Columns; ++n) {
    column[n] = matrix + columns[n] * column_stride;
    ahead[n] = matrix + next[n] * column_stride;
    for (uint32_t r = 0; r < Results; ++r) factor[r][n] = _mm256_set1_ps(factors[r][n] / kStoredScale<Element>);
  }
  for (uint32_t row = row_begin; row < row_end; row += kP) {
    __m256 low[Results], high[Results];
#pragma GCC unroll 3
    for (uint32_t r = 0; r < Results; ++r) {
      low[r] = _mm256_loadu_ps(out[r] + row);
      high[r] = _mm256_loadu_ps(out[r] + row + 8);
    }
#pragma GCC unroll 8
    for (uint32_t n = 0; n < Columns; ++n) {
      if constexpr (sizeof(Element) == sizeof(Half))  // fp32 waits for memory alone, and gains nothing
        _mm_prefetch(reinterpret_cast<const char*>(ahead[n] + row), _MM_HINT_T1);
      const __m256 value0 = load8(column[n] + row), value1 = load8(column[n] + row + 8);
#pragma GCC unroll 3
      for (uint32_t r = 0; r < Results; ++r) {
        low[r] = _mm256_fmadd_ps(value0, factor[r][n], low[r]);
        high[r] = _mm256_fmadd_ps(value1, factor[r][n], high[r]);
      }
    }
#pragma GCC unroll 3
    for (uint32_t r = 0; r < Results; ++r) {
      _mm256_storeu_ps(out[r] + row, low[r]);
      _mm256_storeu_ps(out[r] + row + 8, high[r]);
    }
  }
}

template <uint32_t Results, class Element>
FF_AVX2 inline void addAll(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                           const uint32_t* columns, const float* const* factors, uint32_t count, float* const* out) {
  constexpr uint32_t kColumns = Results == 1 ? 8 : 4;  // factors and sums stay in registers
  uint32_t i = 0;
  const float* at[Results];
  for (; i + kColumns <= count; i += kColumns) {
    for (uint32_t r = 0; r < Results; ++r) at[r] = factors[r] + i;
    const uint32_t* next = i + 2 * kColumns <= count ? columns + i + kColumns : columns + i;
    addSome<kColumns, Results>(matrix, column_stride, row_begin, row_end, columns + i, next, at, out);
  }
  for (; i < count; ++i) {
    for (uint32_t r = 0; r < Results; ++r) at[r] = factors[r] + i;
    addSome<1, Results>(matrix, column_stride, row_begin, row_end, columns + i, columns + i, at, out);
  }
}

template <class Element>
FF_AVX2 void addColumns(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                        const uint32_t* columns, const float* factors, uint32_t count, float* out) {
  addAll<1>(matrix, column_stride, row_begin, row_end, columns, &factors, count, &out);
}
template <class Element>
FF_AVX2 void addColumns3(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                         const uint32_t* columns, const float* const factors[3], uint32_t count, float* const out[3]) {
  addAll<3>(matrix, column_stride, row_begin, row_end, columns, factors, count, out);
}

template <uint32_t Vectors8, class Element>
FF_AVX2 inline void gatherTile(const Element* matrix, size_t column_stride, uint32_t row, const SparseVectors& v,
                               float* out) {
  for (uint32_t p = 0; p < v.k; ++p) {
    __m256 sum[Vectors8];
#pragma GCC unroll 8
    for (uint32_t i = 0; i < Vectors8; ++i) sum[i] = _mm256_setzero_ps();
    for (uint32_t e = v.start[p]; e < v.start[p + 1]; ++e) {
      const uint32_t index = v.index[e];
      const Element* column = matrix + index * column_stride + row;
      const __m256 factor = _mm256_set1_ps(v.value[e] * v.weight[index] / kStoredScale<Element>);
#pragma GCC unroll 8
      for (uint32_t i = 0; i < Vectors8; ++i) sum[i] = _mm256_fmadd_ps(load8(column + 8 * i), factor, sum[i]);
    }
#pragma GCC unroll 8
    for (uint32_t i = 0; i < Vectors8; ++i)
      _mm256_storeu_ps(out + panelIndex(row + 8 * i, p), sum[i]);
  }
}

template <class Element>
FF_AVX2 void gatherColumns(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                           const SparseVectors& vectors, float* out) {
  uint32_t row = row_begin;
  for (; row + 64 <= row_end; row += 64) gatherTile<8>(matrix, column_stride, row, vectors, out);
  for (; row < row_end; row += kP) gatherTile<2>(matrix, column_stride, row, vectors, out);
}

// 8 rows of 8 columns, to 8 columns a row.
template <class Element>
FF_AVX2 inline void transpose8(const Element* matrix, size_t column_stride, float* out) {
  __m256 in[8], pair[8], quad[8];
#pragma GCC unroll 8
  for (uint32_t i = 0; i < 8; ++i) in[i] = load8(matrix + i * column_stride);
#pragma GCC unroll 4
  for (uint32_t i = 0; i < 8; i += 2) {
    pair[i] = _mm256_unpacklo_ps(in[i], in[i + 1]);
    pair[i + 1] = _mm256_unpackhi_ps(in[i], in[i + 1]);
  }
#pragma GCC unroll 2
  for (uint32_t i = 0; i < 8; i += 4) {
    quad[i] = _mm256_shuffle_ps(pair[i], pair[i + 2], 0x44);
    quad[i + 1] = _mm256_shuffle_ps(pair[i], pair[i + 2], 0xee);
    quad[i + 2] = _mm256_shuffle_ps(pair[i + 1], pair[i + 3], 0x44);
    quad[i + 3] = _mm256_shuffle_ps(pair[i + 1], pair[i + 3], 0xee);
  }
#pragma GCC unroll 4
  for (uint32_t i = 0; i < 4; ++i) {
    _mm256_storeu_ps(out + i * kP, _mm256_permute2f128_ps(quad[i], quad[i + 4], 0x20));
    _mm256_storeu_ps(out + (i + 4) * kP, _mm256_permute2f128_ps(quad[i], quad[i + 4], 0x31));
  }
}

template <class Element>
FF_AVX2 void gatherRows(const Element* matrix, size_t column_stride, uint32_t first_column, const uint32_t* blocks,
                        uint32_t block_count, const SparseVectors& v, float* scratch, float* out) {
  const Element* from = matrix + first_column * column_stride;
  for (uint32_t b = 0; b < block_count; ++b) {
    const uint32_t row = 8 * blocks[b];
    transpose8(from + row, column_stride, scratch + size_t{row} * kP);
    transpose8(from + row + 8 * column_stride, column_stride, scratch + size_t{row} * kP + 8);
  }
  for (uint32_t p = 0; p < v.k; ++p) {
    __m256 even0 = _mm256_setzero_ps(), even1 = even0, odd0 = even0, odd1 = even0;
    uint32_t e = v.start[p];
    const uint32_t end = v.start[p + 1];
    for (; e + 2 <= end; e += 2) {
      const uint32_t i = v.index[e], j = v.index[e + 1];
      const __m256 f = _mm256_set1_ps(v.value[e] * v.weight[i] / kStoredScale<Element>);
      const __m256 g = _mm256_set1_ps(v.value[e + 1] * v.weight[j] / kStoredScale<Element>);
      even0 = _mm256_fmadd_ps(_mm256_loadu_ps(scratch + size_t{i} * kP), f, even0);
      even1 = _mm256_fmadd_ps(_mm256_loadu_ps(scratch + size_t{i} * kP + 8), f, even1);
      odd0 = _mm256_fmadd_ps(_mm256_loadu_ps(scratch + size_t{j} * kP), g, odd0);
      odd1 = _mm256_fmadd_ps(_mm256_loadu_ps(scratch + size_t{j} * kP + 8), g, odd1);
    }
    if (e < end) {
      const uint32_t i = v.index[e];
      const __m256 f = _mm256_set1_ps(v.value[e] * v.weight[i] / kStoredScale<Element>);
      even0 = _mm256_fmadd_ps(_mm256_loadu_ps(scratch + size_t{i} * kP), f, even0);
      even1 = _mm256_fmadd_ps(_mm256_loadu_ps(scratch + size_t{i} * kP + 8), f, even1);
    }
    alignas(32) float sum[kP];
    _mm256_store_ps(sum, _mm256_add_ps(even0, odd0));
    _mm256_store_ps(sum + 8, _mm256_add_ps(even1, odd1));
    for (uint32_t n = 0; n < kP; ++n) out[size_t{first_column + n} * kFactorStride + p] = sum[n];
  }
}

}  // namespace

bool haveAvx2Kernels() {
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("f16c");
}
template <class Element>
BounceKernels<Element> avx2Kernels() {
  return {addProduct<Element>, addColumns<Element>, addColumns3<Element>, gatherColumns<Element>, gatherRows<Element>};
}

}  // namespace ff::runtime
#else
namespace ff::runtime {
bool haveAvx2Kernels() { return false; }
template <class Element>
BounceKernels<Element> avx2Kernels() {
  return portableKernels<Element>();
}
}  // namespace ff::runtime
#endif

namespace ff::runtime {
template BounceKernels<float> avx2Kernels<float>();
template BounceKernels<Half> avx2Kernels<Half>();
}  // namespace ff::runtime
