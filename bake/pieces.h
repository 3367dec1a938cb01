// A scene's triangles clipped to grid cells: the pieces that patches are made of.
//
// A wall goes on behind its skirting board, a tube has an inside: where a piece is partly open and partly enclosed, it is
// cut on into halves of the cell, down to an eighth, so that one patch need not be both. Otherwise the light of what is
// seen would seep into what is not, and what is seen would be too dark by as much.
#pragma once
#include <cstdint>
#include <vector>

#include "bake/hilbert.h"
#include "bake/ray_caster.h"
#include "bake/scene.h"
#include "bake/sobol.h"

namespace ff::bake {

// In units of cells.
struct Point {
  double x, y, z;
  double& operator[](int i) { return i == 0 ? x : i == 1 ? y : z; }
  double operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
};
inline Point operator-(Point a, Point b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline double dot(Point a, Point b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Point cross(Point a, Point b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

using Polygon = std::vector<Point>;  // convex
Point vectorArea(const Polygon& polygon);

inline constexpr int kDeepestPiece = 3;  // a piece lies in a cube of cell / 2^depth, depth 0 to this

enum class Enclosure : uint8_t {
  kOpen,
  kCrevice,  // most of what it sees is nearer than a cell: behind a skirting board, inside a step
  kPocket    // light gets neither in nor out, and nothing shines inside: a closed tube, what another surface lies on
};

struct Piece {
  Cell cell;          // of the grid of patches
  int depth = 0;
  Cell cube;          // of the grid of cell / 2^depth
  uint32_t triangle;  // of the scene
  Polygon polygon;
  Enclosure enclosure[2] = {};  // front, back
};

class PieceCutter {
 public:
  // caster: null where all counts as open. Scene and caster outlive the cutter.
  PieceCutter(const Scene& scene, float cell_m, const RayCaster* caster) : scene_(scene), caster_(caster), cell_m_(cell_m) {}
  // Appends a triangle's pieces, by (depth, cube); at least one. Thread-safe.
  void cut(uint32_t triangle, std::vector<Piece>& out) const;

 private:
  static constexpr uint32_t kMostProbes = 32;  // rays that tell how enclosed a piece is
  double eps(uint32_t triangle) const;  // what counts as rounding of its coordinates, cells
  void divide(Piece piece, std::vector<Piece>& out) const;
  struct Sight {
    Enclosure enclosure;
    bool mixed;  // may be of two kinds
  };
  Sight look(const Piece& piece, bool back) const;
  bool isCovered(uint32_t triangle, Vec3 point, Vec3 normal) const;
  bool getsOut(Ray ray, uint64_t seed) const;

  const Scene& scene_;
  const RayCaster* caster_;
  float cell_m_;
  SobolTable points_{kMostProbes};
};

}  // namespace ff::bake
