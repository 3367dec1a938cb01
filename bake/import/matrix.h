// Affine transforms of glTF nodes. Private to this folder.
#pragma once
#include <array>
#include <cstddef>

namespace ff::bake::gltf {

using Matrix = std::array<double, 16>;  // column-major, last row 0 0 0 1

// t: 3 numbers, q: unit quaternion x y z w, s: 3 numbers.
inline Matrix compose(const double* t, const double* q, const double* s) {
  const double x = q[0], y = q[1], z = q[2], w = q[3];
  return {s[0] * (1 - 2 * (y * y + z * z)),
          s[0] * (2 * (x * y + z * w)),
          s[0] * (2 * (x * z - y * w)),
          0,
          s[1] * (2 * (x * y - z * w)),
          s[1] * (1 - 2 * (x * x + z * z)),
          s[1] * (2 * (y * z + x * w)),
          0,
          s[2] * (2 * (x * z + y * w)),
          s[2] * (2 * (y * z - x * w)),
          s[2] * (1 - 2 * (x * x + y * y)),
          0,
          t[0],
          t[1],
          t[2],
          1};
}

inline Matrix multiply(const Matrix& a, const Matrix& b) {
  Matrix out{};
  for (size_t c = 0; c < 4; ++c)
    for (size_t r = 0; r < 4; ++r)
      for (size_t k = 0; k < 4; ++k) out[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return out;
}

inline double determinant(const Matrix& m) {
  return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[4] * (m[1] * m[10] - m[2] * m[9]) + m[8] * (m[1] * m[6] - m[2] * m[5]);
}

inline bool isMirror(const Matrix& m) { return determinant(m) < 0; }

}  // namespace ff::bake::gltf
