// What parts surface: a wall that stands on a floor, a sheet whose edge lies in it, a shelf, a frame, a foot.
//
// Light may differ on the two sides of such a *fence*, so no patch may reach across one. Pieces are cut along the lines where
// other surfaces meet them; then those that see each other a hair above the surface belong together again, so that only true
// partitions part. A hair is a thousandth of a cell, or what rounding asks for: a gap narrower than that counts as closed.
// What hangs *low*, less than a tenth of a cell above a surface, parts it as well: next to no light gets under a door, or behind a moulding, a picture.
// Where two triangles lie in one plane, rays meet either, as rounding has it: surface is *doubled* where the other one stands for both.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "bake/paging.h"
#include "bake/rays/ray_caster.h"
#include "bake/scene.h"
#include "bake/surface/hilbert.h"
#include "bake/surface/polygon.h"

namespace ff::bake {

struct Piece {
  Cell cell;            // of the triangle's own grid (fineness.h)
  uint32_t triangle;    // of the scene
  int fineness;
  PolygonView polygon;  // in units of base cells, seen from the triangle's front; whoever makes a piece keeps its corners
  // Of the front and the back:
  bool fenced[2] = {};   // something stands on it or at its border: ask `Fences::between` what it is connected to
  bool covered[2] = {};  // another surface lies on it, less than a hair away, or hangs low over it
  bool low[2] = {};      // something may hang low over it or at its border
  bool doubled[2] = {};  // in its plane lies what stands for it (`Fences::doubleOf`); covered as well
};

// Pieces with their corners, as many as a world has.
class PieceList {
 public:
  // Copies the corners; polygons of pieces are those of the list from the next close() on.
  void add(const Piece& piece) {
    corners_.insert(corners_.end(), piece.polygon.begin(), piece.polygon.end());
    pieces_.push_back(piece);
  }
  void close() {
    size_t at = 0;
    for (Piece& piece : pieces_) {
      piece.polygon = {corners_.data() + at, piece.polygon.size()};
      at += piece.polygon.size();
    }
  }
  size_t size() const { return pieces_.size(); }
  bool empty() const { return pieces_.empty(); }
  const Piece& operator[](size_t i) const { return pieces_[i]; }
  auto begin() const { return pieces_.begin(); }
  auto end() const { return pieces_.end(); }

 private:
  PagedVector<Piece> pieces_;
  PagedVector<Point> corners_;
};

struct PieceSide {
  const Piece* piece;
  bool back;
};

class Fences {
 public:
  // Scene and caster outlive this.
  Fences(const Scene& scene, float cell_m, const RayCaster& caster)
      : scene_(scene), caster_(caster), cell_m_(static_cast<double>(cell_m)) {}

  // Cuts a piece along the fences that part one of its sides, and appends what comes of it: mostly the piece itself.
  // Thread-safe, as all of this class.
  void cut(const Piece& piece, PieceList& out) const;

  enum class Border { kApart, kClosed, kOpen };
  // Whether two pieces share a border, and see each other across it.
  Border between(PieceSide a, PieceSide b) const;
  // The same of one border: `shared` is one of sharedBorders(a, b).
  bool isOpen(PieceSide a, PieceSide b, const SharedBorder& shared) const;

  // Whether the middles of two pieces see each other, both from a hair above.
  bool sees(PieceSide a, PieceSide b) const;

  // Whether they are in one space: whether what is before the one sees what is before the other, from half way to what is opposite, a quarter of their own cell away
  // at most.
  bool shareSpace(PieceSide a, PieceSide b) const;

  // Whether another surface lies on a triangle's side at a point of it (cells), less than a hair away: a picture on its wall.
  bool isCovered(uint32_t triangle, bool back, Point point) const;

  // What stands for a triangle's side at a point of it (cells): of the triangles in its plane that are seen from there, have patches and no holes, a lamp's,
  // else the first of the scene. kNone: it does itself.
  struct Double {
    uint32_t triangle = kNone;
    bool front = true;
  };
  Double doubleOf(uint32_t triangle, bool back, Point point) const;

 private:
  struct Found;
  Found find(const Piece& piece) const;
  bool isClear(Vec3 from, Vec3 to) const;  // whether nothing is between two points, m
  bool hides(PieceSide of, const Point& eye, const Point& to) const;
  std::array<Point, 3> cornersOf(uint32_t triangle) const;
  Point normalOf(uint32_t triangle) const;
  bool inOnePlane(uint32_t t, uint32_t u) const;
  // Of two that are: which one stands for both where both have patches and no holes, and whether the other one does for a side of a triangle.
  bool comesFirst(uint32_t t, uint32_t u) const;
  bool standsFor(uint32_t other, uint32_t triangle, bool back) const;
  // Whether another surface hangs low over a triangle's side at a point of it (cells), a hair off or more.
  bool isUnder(uint32_t triangle, bool back, Point point) const;
  double hairOf(uint32_t triangle) const;   // cells
  double lowOf(uint32_t triangle) const;    // cells
  double touchOf(uint32_t triangle) const;  // nearer than this, cells, two surfaces are one
  Vec3 metres(Point p) const;

  const Scene& scene_;
  const RayCaster& caster_;
  double cell_m_;
};

inline constexpr double kBorderCells = 2e-3;  // borders that lie so near each other are one

}  // namespace ff::bake
