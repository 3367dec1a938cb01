// Cuts a scene's triangles into patches: pieces of surface that are connected, in one grid cell, one orientation class and one
// lamp group or none. Materials of another density have a grid of their own (fineness.h). A thin wall's two sides, two floors in
// one cell, a lamp and its shade, a floor on both sides of a wall that stands on it (fences.h) are never one patch. Sealed surface
// (sealed.h), which no light gets to, has none; its rims are kept for drawing. Crumbs join a neighbour (components.h), so that a patch may reach a little over
// its cell's border. Double-sided surfaces get a patch a side.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/memory.h"
#include "bake/rays/ray_caster.h"
#include "bake/scene.h"
#include "bake/surface/components.h"
#include "bake/surface/fineness.h"
#include "bake/surface/hilbert.h"
#include "bake/surface/lamp_groups.h"
#include "bake/surface/merging.h"
#include "bake/surface/polygon.h"
#include "bake/work_count.h"
#include "formats/model.h"

namespace ff::bake {

inline constexpr uint32_t kOrientations = 6;  // dominant axis of the normal and its sign: +x -x +y -y +z -z

struct Patch {
  Cell cell{};              // of the base grid
  uint64_t key = 0;         // hilbertKey(cell)
  uint64_t name = 0;        // of the cell and of its number there: what a patch's random numbers are made of, so that they are the same
                            // whatever stands elsewhere
  int fineness = 0;         // of its own grid
  uint32_t orientation = 0;
  uint16_t lamp_group = formats::kNoLampGroup;  // of its material, if that emits: emitters of two groups, or one and
                                                // what holds it, never share a patch or a cluster
  bool emits() const { return lamp_group != formats::kNoLampGroup; }
  float area_m2 = 0;        // cutout holes are not counted
  Vec3 centroid, normal;    // m; area-weighted means
  Vec3 albedo, emission;    // linear RGB; M in W/m2
  Box bounds;
  uint32_t first_triangle = 0, triangles = 0;  // range of PatchSet::triangles
};

// A triangle of a clipped piece; corners in metres, wound as seen from the patch's front.
struct PatchTriangle {
  Vec3 a, b, c;
  float cumulative_area = 0;  // within the patch, up to and including this one; holes not counted
  uint32_t source = 0;        // triangle of the scene
};

// A triangle of sealed surface where a scene triangle goes on in a patch: drawn with that patch's light, so that no gap opens where
// an eye sees a hair of it beside what lies on it.
struct SealedTriangle {
  Vec3 a, b, c;
  uint32_t source = 0;        // triangle of the scene
  uint32_t patch = 0;         // the nearest one on the same side of `source`
};

class PatchSet {
 public:
  PagedVector<Patch> patches;            // sorted by (key, orientation, lamp group, own grid, cell of that, first piece)
  PagedVector<PatchTriangle> triangles;  // by patch
  PagedVector<SealedTriangle> sealed;    // by patch
  float cell_m = 1;
  double area_m2 = 0, sealed_m2 = 0;     // of the patches; of sealed surface, which has none
  uint64_t unmerged = 0;                 // how many patches there were before some were merged (merging.h); 0: that was not asked for
  std::array<uint64_t, kMaxMergedLog> merged{};  // patches that fill up to 2, 4, 8 cells a side

  // The patch that covers point p of scene triangle t on its front or back side; kNone where that side has none,
  // kSealed where it is sealed. A point that rounding puts just outside all pieces gets the piece of the nearest cell.
  uint32_t patchAt(uint32_t t, bool front, Vec3 p) const {
    const uint32_t first = piece_start_[t], last = piece_start_[t + 1];
    if (last - first == 1) return pieces_[first].patch[front ? 0 : 1];
    return searchPatch(t, front, p);
  }

  // What patchAt() and eachCut() need; once all rays are cast nobody does.
  void forgetPieces() {
    release(piece_start_);
    release(fineness_);
    release(pieces_);
    release(rims_);
  }

  // f(triangle of the scene, box of a cell in m, pieces of the triangle there, outline) for every cell that a triangle has pieces in, by triangle, cells
  // ascending. Of a piece: cell, and patch[2], as patchAt() says for its front and back; outline(piece) are its sides, none where it is the only one there: of
  // each at, inward; in cells.
  template <class F>
  void eachCut(F f) const {
    for (uint32_t t = 0; t + 1 < piece_start_.size(); ++t)
      for (uint32_t k = piece_start_[t], end = k; k < piece_start_[t + 1]; k = end) {
        while (end < piece_start_[t + 1] && pieces_[end].cell == pieces_[k].cell) ++end;
        const Cell& cell = pieces_[k].cell;
        const float edge_m = cell_m * static_cast<float>(edgeCells(fineness_[t]));
        const Vec3 lo{static_cast<float>(cell[0]), static_cast<float>(cell[1]), static_cast<float>(cell[2])};
        f(t, Box{lo * edge_m, (lo + Vec3{1, 1, 1}) * edge_m}, std::span(&pieces_[k], end - k),
          [this](const CutPiece& piece) { return std::span(rims_).subspan(piece.first_rim, piece.rims); });
      }
  }

  // The base cells that a patch lies in, crumbs apart: `cell` alone unless it is coarser. That is as near as its triangles' planes tell.
  std::vector<Cell> cellsOf(const Patch& patch) const;

 private:
  friend class PatchBuilder;
  struct CutPiece {
    Cell cell;                           // of the triangle's own grid
    uint32_t patch[2] = {kNone, kNone};  // front, back
    uint32_t first_rim = 0, rims = 0;    // its outline where a triangle has several pieces in a cell
  };
  struct Rim {  // the line through a side of a polygon; base cells
    Point at, inward;
  };
  uint32_t searchPatch(uint32_t t, bool front, Vec3 p) const;

  PagedVector<uint32_t> piece_start_;  // per scene triangle
  PagedVector<int8_t> fineness_;       // likewise
  PagedVector<CutPiece> pieces_;       // by triangle, cells ascending
  PagedVector<Rim> rims_;
};

inline constexpr double kMostPieces = 5e8;
// Of one grid of cells: surface alone, no cuts where surfaces meet.
double fewestPieces(const Scene& scene, double cell_m);

struct PatchSettings {
  float cell_m = 1;
  WorkCount* done = nullptr;  // counts triangles as they are cut, and the surfaces that are judged; may be null
  float crumb_fraction = 0.05f;
  float metals = 1;  // share of a metal's mirror reflection that is carried on as diffuse light: albedo =
                     // base colour * (1 - metallic * (1 - metals)). 1 keeps its energy, 0 its darkness in a diffuse model.
  float merge_error = 0;  // patches become one within this error, relative: merging.h; 0: none do
  double max_pieces = kMostPieces;  // more than what surfaces that meet may be cut into are refused
};

// Errors (kUsage): cell size not positive, or so small that the scene spans more than 2^20 cells or is cut into more than max_pieces.
// caster: of the scene; null: nothing is parted, sealed or merged.
Result<PatchSet> makePatches(const Scene& scene, const PatchSettings& settings, const RayCaster* caster = nullptr);

}  // namespace ff::bake
