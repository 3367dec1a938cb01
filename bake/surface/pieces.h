// A scene's triangles clipped to the cells of their grids (fineness.h) and cut where other surfaces part them: the pieces that
// patches are made of.
#pragma once
#include <cstdint>

#include "bake/scene.h"
#include "bake/surface/fences.h"
#include "bake/surface/hilbert.h"
#include "bake/surface/polygon.h"

namespace ff::bake {

class PieceCutter {
 public:
  // fences: null where nothing parts anything. Scene and fences outlive the cutter.
  PieceCutter(const Scene& scene, float cell_m, const Fences* fences) : scene_(scene), fences_(fences), cell_m_(cell_m) {}
  // Appends a triangle's pieces, by cell; at least one. Thread-safe.
  void cut(uint32_t triangle, PieceList& out) const;

 private:
  const Scene& scene_;
  const Fences* fences_;
  float cell_m_;
};

}  // namespace ff::bake
