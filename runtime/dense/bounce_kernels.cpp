#include "runtime/dense/bounce_kernels.h"

namespace ff::runtime {
namespace {

float load(const float* p) { return *p; }
float load(const Half* p) { return toFloat(*p); }
void store(float* p, float value) { *p = value; }
void store(Half* p, float value) { *p = toHalf(value); }

template <class Element>
void addProduct(const float* a, uint32_t k, const float* b, Element* matrix, size_t column_stride, uint32_t row_begin,
                uint32_t row_end, uint32_t columns) {
  for (uint32_t column = 0; column < columns; ++column)
    for (uint32_t row = row_begin; row < row_end; row += kPanelRows) {
      const float* panel = a + panelIndex(row, 0);
      float sum[kPanelRows] = {};
      for (uint32_t p = 0; p < k; ++p)
        for (uint32_t i = 0; i < kPanelRows; ++i) sum[i] += panel[p * kPanelRows + i] * b[size_t{column} * kFactorStride + p];
      Element* at = matrix + column * column_stride + row;
      for (uint32_t i = 0; i < kPanelRows; ++i) store(at + i, load(at + i) + sum[i] * kStoredScale<Element>);
    }
}

template <class Element>
void addColumns(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                const uint32_t* columns, const float* factors, uint32_t count, float* out) {
  for (uint32_t i = 0; i < count; ++i) {
    const Element* column = matrix + columns[i] * column_stride;
    const float factor = factors[i] / kStoredScale<Element>;
    for (uint32_t row = row_begin; row < row_end; ++row) out[row] += load(column + row) * factor;
  }
}

template <class Element>
void addColumns3(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                 const uint32_t* columns, const float* const factors[3], uint32_t count, float* const out[3]) {
  for (int c = 0; c < 3; ++c) addColumns(matrix, column_stride, row_begin, row_end, columns, factors[c], count, out[c]);
}

template <class Element>
void gatherColumns(const Element* matrix, size_t column_stride, uint32_t row_begin, uint32_t row_end,
                   const SparseVectors& v, float* out) {
  for (uint32_t row = row_begin; row < row_end; row += kPanelRows)
    for (uint32_t p = 0; p < v.k; ++p) {
      float sum[kPanelRows] = {};
      for (uint32_t e = v.start[p]; e < v.start[p + 1]; ++e) {
        const Element* column = matrix + v.index[e] * column_stride + row;
        const float factor = v.value[e] * v.weight[v.index[e]] / kStoredScale<Element>;
        for (uint32_t i = 0; i < kPanelRows; ++i) sum[i] += load(column + i) * factor;
      }
      for (uint32_t i = 0; i < kPanelRows; ++i) out[panelIndex(row + i, p)] = sum[i];
    }
}

template <class Element>
void gatherRows(const Element* matrix, size_t column_stride, uint32_t first_column, const uint32_t*, uint32_t,
                const SparseVectors& v, float*, float* out) {
  for (uint32_t column = first_column; column < first_column + kPanelRows; ++column)
    for (uint32_t p = 0; p < v.k; ++p) {
      float sum = 0;
      for (uint32_t e = v.start[p]; e < v.start[p + 1]; ++e)
        sum += load(matrix + column * column_stride + v.index[e]) *
               (v.value[e] * v.weight[v.index[e]] / kStoredScale<Element>);
      out[size_t{column} * kFactorStride + p] = sum;
    }
}

}  // namespace

template <class Element>
BounceKernels<Element> portableKernels() {
  return {addProduct<Element>, addColumns<Element>, addColumns3<Element>, gatherColumns<Element>, gatherRows<Element>};
}
template BounceKernels<float> portableKernels<float>();
template BounceKernels<Half> portableKernels<Half>();

}  // namespace ff::runtime
