// Larger patches where they lose nothing: where light is smooth and materials agree, as on flat ground and large walls.
//
// Patches of one orientation that touch along a border become one where they fill up to eight cells a side, a cube of the grid, so that an edit moves no
// border. They must differ in normal, albedo and the light that they see by no more than an error that is asked for. That light is made up, so that it
// is known before any light is: an open sky, with a low sun on one of four sides or none, falls on grey surfaces. All patches look along the same
// directions, so that what differs between two of them is what they see and not chance. What emits, has holes, or is stood on or lain on by other surface
// stays as it was cut, and so does what faces a lamp nearby: its light changes from cell to cell.
#pragma once
#include <span>

#include "bake/rays/ray_caster.h"
#include "bake/scene.h"
#include "bake/surface/components.h"

namespace ff::bake {

inline constexpr int kMaxMergedLog = 3;       // cells a side of the largest merged patch, log2
inline constexpr uint32_t kLookDirections = 256;  // over the sphere; half of them lie above a patch
inline constexpr float kMergedTurn = 0.95f;   // least cosine between the normals of a merged patch and of its parts
inline constexpr double kLampEdges = 4;       // lamps nearer than so many edges of the cube keep its patches apart

struct MergeSettings {
  float cell_m = 1;
  float error = 0;   // most by which albedo and light of the parts may differ from their middle, relative; above 0
  float metals = 1;  // PatchSettings::metals
};

// Renumbers `labels` as PatchSet is sorted, and fills labels.doublings. pieces, sides: those that were labelled. On all of TBB's threads; a pure function
// of what is near, and of what the patches see.
void mergePatches(const Scene& scene, const RayCaster& caster, const MergeSettings& settings, const PieceList& pieces, std::span<const Side> sides,
                  Labels& labels);

}  // namespace ff::bake
