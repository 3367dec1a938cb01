// The inner loops of the dense CPU solvers on column-major matrices, fp32 or fp16 with fp32 sums. Two implementations,
// portable and AVX2 + FMA + F16C, chosen by what the processor can do; a test compares them. The result of an element
// never depends on how a matrix is cut into calls, so neither does it on the number of threads.
#pragma once
#include <cstddef>
#include <cstdint>

#include "runtime/dense/bounce_matrix.h"
#include "runtime/dense/half.h"

namespace ff::runtime {

inline constexpr uint32_t kPanelRows = 16;  // rows of matrices are padded to a multiple
// The two factors of an update, `tall` (rows x rank) and `wide` (rank x columns), have room for two blocks.
inline constexpr uint32_t kMaxRank = 2 * kMaxBlock;
inline constexpr uint32_t kFactorStride = kMaxRank + kPanelRows;  // of `wide`, from column to column

// Where `tall` holds a value: panels of 16 rows.
inline size_t panelIndex(uint32_t row, uint32_t p) {
  return (size_t{row / kPanelRows} * kMaxRank + p) * kPanelRows + row % kPanelRows;
}

// Stored fp16 is 8 times the value: 7.6e-6 and above are normal numbers, and 8191 (above the most that a clamped albedo
// allows) does not overflow.
inline constexpr float kHalfScale = 8;

template <class Element>
inline constexpr float kStoredScale = 1;
template <>
inline constexpr float kStoredScale<Half> = kHalfScale;

// A sparse matrix, k vectors of (index, value); a value is taken times weight[index].
struct SparseVectors {
  uint32_t k = 0;
  const uint32_t* start = nullptr;  // k + 1
  const uint32_t* index = nullptr;
  const float* value = nullptr;
  const float* weight = nullptr;
};

// Row ranges are multiples of kPanelRows. column_stride: elements from one column to the next.
template <class Element>
struct BounceKernels {
  // matrix[rows, columns] += a b, k products each. a: a[panelIndex(row, p)]; b: b[column * kFactorStride + p]. Columns are
  // numbered from those of `matrix` and `b`.
  void (*addProduct)(const float* a, uint32_t k, const float* b, Element* matrix, size_t column_stride,
                     uint32_t row_begin, uint32_t row_end, uint32_t columns);
  // out[rows] += sum of matrix[rows, columns[i]] * factor[i].
  void (*addColumns)(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                     const uint32_t* columns, const float* factors, uint32_t count, float* out);
  // The same with three factors and three results at once.
  void (*addColumns3)(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                      const uint32_t* columns, const float* const factors[3], uint32_t count, float* const out[3]);
  // out[rows, p] = sum over vector p of matrix[rows, index] * value * weight; in out[panelIndex(row, p)].
  void (*gatherColumns)(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                        const SparseVectors& vectors, float* out);
  // out[column * kFactorStride + p] = sum over vector p of matrix[index, column] * value * weight, for 16 columns from
  // `first_column`. blocks: the blocks of 8 rows that hold all indices. scratch: 16 floats per row of the matrix.
  void (*gatherRows)(const Element* matrix, size_t column_stride, uint32_t first_column, const uint32_t* blocks,
                     uint32_t block_count, const SparseVectors& vectors, float* scratch, float* out);
};

template <class Element>
BounceKernels<Element> portableKernels();
// False where this build or this processor lacks AVX2, FMA or F16C.
bool haveAvx2Kernels();
template <class Element>
BounceKernels<Element> avx2Kernels();
// The better of the two.
template <class Element>
BounceKernels<Element> bounceKernels() {
  return haveAvx2Kernels() ? avx2Kernels<Element>() : portableKernels<Element>();
}

}  // namespace ff::runtime
