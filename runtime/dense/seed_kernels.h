// The passes of the seed's method over its RGBA16F matrix, column-major, four halves an element. Portable and AVX2.
#pragma once
#include "runtime/cut/local_matrix.h"
#include "runtime/dense/half.h"

namespace ff::runtime {

struct Half4 {
  Half x, y, z, w;
};

// Rows [0, rows) of whole columns; rows is even.
struct SeedKernels {
  // out[row] += matrix[row, column] * factor[column], for row_begin <= row < row_end, both even.
  void (*multiply)(const Half4* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end, uint32_t columns,
                   const Vec4* factor, Vec4* out);
  // out[column] = sum of factor[row] * matrix[row, column].
  void (*multiplyLeft)(const Half4* matrix, size_t column_stride, uint32_t rows, uint32_t column_begin,
                       uint32_t column_end, const Vec4* factor, Vec4* out);
  // matrix[row, column] += col[row] * row_vector[column].
  void (*addOuter)(Half4* matrix, size_t column_stride, uint32_t rows, uint32_t column_begin, uint32_t column_end,
                   const Vec4* col, const Vec4* row_vector);
};

SeedKernels portableSeedKernels();
SeedKernels avx2SeedKernels();  // where haveAvx2Kernels()
SeedKernels seedKernels();      // the better of the two

}  // namespace ff::runtime
