// Patches that are finer or coarser than elsewhere: a material's density rounded to a power of two, 2^fineness. Its triangles are
// clipped to a grid of their own, whose cells are 2^fineness times finer than the base grid's. Coordinates stay in base cells;
// one base cell holds whole cells of a finer grid, and a cell of a coarser grid goes by the base cell at its middle.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>

#include "bake/point.h"
#include "bake/scene.h"
#include "bake/surface/hilbert.h"

namespace ff::bake {

inline constexpr int kMaxFineness = 4;  // log2(kLargestDensity)

inline int finenessOf(float density) {
  const double square = static_cast<double>(density) * static_cast<double>(density);
  return std::clamp((std::ilogb(square) + 1) >> 1, -kMaxFineness, kMaxFineness);
}

inline int finenessOf(const Scene& scene, uint32_t triangle) { return finenessOf(scene.materials[scene.triangles[triangle].material].density); }

// An own cell's edge and face, in base cells.
inline double edgeCells(int fineness) { return fineness > 0 ? 1.0 / (1 << fineness) : 1 << -fineness; }
inline double faceCells(int fineness) { return edgeCells(fineness) * edgeCells(fineness); }

inline Cell baseCell(Cell own, int fineness) {
  for (int32_t& x : own) x = fineness >= 0 ? x >> fineness : x * (1 << -fineness) + (1 << (-fineness - 1));
  return own;
}

// Where an own cell comes along the Hilbert curve within its base cell.
inline uint16_t placeInBaseCell(Cell own, int fineness) {
  if (fineness <= 0) return 0;
  for (int32_t& x : own) x &= (1 << fineness) - 1;
  return static_cast<uint16_t>(hilbertKey(own) & ((1u << 3 * kMaxFineness) - 1));
}

// Where a corner lies in a grid of that edge (base cells), from the corner of one of its cells, in 1/512 of the edge: corners of which this is the same are one.
using GridCorner = std::array<int32_t, 3>;
inline GridCorner gridCorner(const Point& p, const Cell& from, double edge) {
  GridCorner at;
  for (size_t i = 0; i < 3; ++i) at[i] = static_cast<int32_t>(std::lround((p[static_cast<int>(i)] / edge - from[i]) * 512));
  return at;
}

}  // namespace ff::bake
