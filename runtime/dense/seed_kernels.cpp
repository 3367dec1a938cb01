#include "runtime/dense/seed_kernels.h"

#include "runtime/dense/bounce_kernels.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace ff::runtime {
namespace {

void multiplyPortable(const Half4* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end, uint32_t columns,
                      const Vec4* factor, Vec4* out) {
  for (uint32_t j = 0; j < columns; ++j)
    for (uint32_t i = row_begin; i < row_end; ++i) {
      const Half4& m = matrix[j * column_stride + i];
      out[i].x += toFloat(m.x) * factor[j].x;
      out[i].y += toFloat(m.y) * factor[j].y;
      out[i].z += toFloat(m.z) * factor[j].z;
    }
}

void multiplyLeftPortable(const Half4* matrix, size_t column_stride, uint32_t rows, uint32_t column_begin,
                          uint32_t column_end, const Vec4* factor, Vec4* out) {
  for (uint32_t j = column_begin; j < column_end; ++j) {
    Vec4 sum;
    for (uint32_t i = 0; i < rows; ++i) {
      const Half4& m = matrix[j * column_stride + i];
      sum.x += toFloat(m.x) * factor[i].x;
      sum.y += toFloat(m.y) * factor[i].y;
      sum.z += toFloat(m.z) * factor[i].z;
    }
    out[j] = sum;
  }
}

void addOuterPortable(Half4* matrix, size_t column_stride, uint32_t rows, uint32_t column_begin, uint32_t column_end,
                      const Vec4* col, const Vec4* row_vector) {
  for (uint32_t j = column_begin; j < column_end; ++j)
    for (uint32_t i = 0; i < rows; ++i) {
      Half4& m = matrix[j * column_stride + i];
      m.x = toHalf(toFloat(m.x) + col[i].x * row_vector[j].x);
      m.y = toHalf(toFloat(m.y) + col[i].y * row_vector[j].y);
      m.z = toHalf(toFloat(m.z) + col[i].z * row_vector[j].z);
    }
}

}  // namespace

SeedKernels portableSeedKernels() { return {multiplyPortable, multiplyLeftPortable, addOuterPortable}; }
SeedKernels seedKernels() { return haveAvx2Kernels() ? avx2SeedKernels() : portableSeedKernels(); }

#if defined(__x86_64__)
#define FF_AVX2 __attribute__((target("avx2,fma,f16c")))
namespace {

// Two elements are eight halves: one register of floats.
FF_AVX2 inline __m256 loadTwo(const Half4* p) {
  return _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(p)));
}
FF_AVX2 inline __m256 twice(const Vec4& v) { return _mm256_broadcast_ps(reinterpret_cast<const __m128*>(&v)); }

template <uint32_t Columns>
FF_AVX2 inline void multiplySome(const Half4* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                                 const Vec4* factor, Vec4* out) {
  __m256 f[Columns];
  for (uint32_t n = 0; n < Columns; ++n) f[n] = twice(factor[n]);
  for (uint32_t i = row_begin; i < row_end; i += 2) {
    __m256 sum = _mm256_loadu_ps(&out[i].x);
#pragma GCC unroll 8
    for (uint32_t n = 0; n < Columns; ++n) sum = _mm256_fmadd_ps(loadTwo(matrix + n * column_stride + i), f[n], sum);
    _mm256_storeu_ps(&out[i].x, sum);
  }
}

FF_AVX2 void multiplyAvx2(const Half4* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                          uint32_t columns, const Vec4* factor, Vec4* out) {
  uint32_t j = 0;
  for (; j + 4 <= columns; j += 4)
    multiplySome<4>(matrix + j * column_stride, column_stride, row_begin, row_end, factor + j, out);
  for (; j < columns; ++j)
    multiplySome<1>(matrix + j * column_stride, column_stride, row_begin, row_end, factor + j, out);
}

FF_AVX2 void multiplyLeftAvx2(const Half4* matrix, size_t column_stride, uint32_t rows, uint32_t column_begin,
                              uint32_t column_end, const Vec4* factor, Vec4* out) {
  for (uint32_t j = column_begin; j < column_end; ++j) {
    const Half4* column = matrix + j * column_stride;
    __m256 sum[4] = {_mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps()};
    uint32_t i = 0;
    for (; i + 8 <= rows; i += 8) {
#pragma GCC unroll 4
      for (uint32_t n = 0; n < 4; ++n)
        sum[n] = _mm256_fmadd_ps(loadTwo(column + i + 2 * n), _mm256_loadu_ps(&factor[i + 2 * n].x), sum[n]);
    }
    for (; i < rows; i += 2) sum[0] = _mm256_fmadd_ps(loadTwo(column + i), _mm256_loadu_ps(&factor[i].x), sum[0]);
    const __m256 all = _mm256_add_ps(_mm256_add_ps(sum[0], sum[1]), _mm256_add_ps(sum[2], sum[3]));
    _mm_storeu_ps(&out[j].x, _mm_add_ps(_mm256_castps256_ps128(all), _mm256_extractf128_ps(all, 1)));
  }
}

FF_AVX2 void addOuterAvx2(Half4* matrix, size_t column_stride, uint32_t rows, uint32_t column_begin,
                          uint32_t column_end, const Vec4* col, const Vec4* row_vector) {
  for (uint32_t j = column_begin; j < column_end; ++j) {
    Half4* column = matrix + j * column_stride;
    const __m256 factor = twice(row_vector[j]);
#pragma GCC unroll 4
    for (uint32_t i = 0; i < rows; i += 2) {
      const __m256 value = _mm256_fmadd_ps(_mm256_loadu_ps(&col[i].x), factor, loadTwo(column + i));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(column + i), _mm256_cvtps_ph(value, _MM_FROUND_TO_NEAREST_INT));
    }
  }
}

}  // namespace
SeedKernels avx2SeedKernels() { return {multiplyAvx2, multiplyLeftAvx2, addOuterAvx2}; }
#else
SeedKernels avx2SeedKernels() { return portableSeedKernels(); }
#endif

}  // namespace ff::runtime
