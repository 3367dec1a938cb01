// How far a frame's light is from obeying B = M + albedo * F B, looked at on a few hundred rows a frame, in turn: cheap
// enough to be always on, whatever solver made the light.
#pragma once
#include <span>

#include "runtime/cut/local_matrix.h"

namespace ff::runtime {

class ResidualMonitor {
 public:
  // Largest |M + albedo * F B - B| of any channel over the largest B, on this frame's share of the leaves. Spans: by slot.
  double look(const LocalMatrix& matrix, std::span<const Vec4> source, std::span<const Vec4> radiosity);

 private:
  uint32_t next_ = 0;  // number in LocalMatrix::leaves
};

}  // namespace ff::runtime
