// The matrix pyramid. A node of level l + 1 gathers the nodes of level l that lie in the same 2x2x2 cells and have the same
// orientation and openness class (interiors, exteriors and crevices must not mix, or the light of a wall seeps into the
// dark behind it), and the same lamp group or none (a lamp is seen where its
// shade is not, and is switched alone), and of what lamps light directly or do not (or the dark underside of an eave shines by night with the
// light of the wall above: of level 2's clusters of a castle at night half were off by 84 %, now by 23 %); up to level kBrightLevels they are of one brightness, too.
// Areas add, exchange areas add.
//
// Tiles form a tree: the children of a tile's nodes fill tiles of their own. They are compact: a cube of cells is one tile, with all classes
// in it, if it is at most 2^kTileEdgeLog cells of its level wide and has at most kTileNodes nodes; else it is cut into its eight, of
// which neighbours along the Hilbert curve share a tile while they fit. So a tile's width is bounded whatever the world. Tiles of a
// level are in the order of their parent tiles, then along the curve; nodes of a tile are sorted by (lamp group, orientation, Hilbert key):
// those that face one way have similar rows. What a node sees (its openness, what lamps light it with) has no part in the order of patches, and little in where tiles end: a
// shadow that an edit throws on a tile moves none of its patches, so that rows elsewhere name them as before. So siblings are near each other
// in their tile, but others may stand between them.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "bake/matrix/level_rows.h"
#include "bake/surface/patches.h"
#include "formats/model.h"

namespace ff::bake {

inline constexpr uint32_t kTopNodes = 2000;     // levels go up until one has at most this many nodes
inline constexpr uint32_t kMaxSiblings = 64;
inline constexpr int kTileEdgeLog = 4;          // 8 cells instead of 16: 3 % more bytes, 1.7 times the tiles, no better a cut (town of 120k)
static_assert(kTileEdgeLog + 1 <= formats::kChunkLog, "what lies beneath a tile lies in one chunk");

// Up to this level what lamps light a node's patches with directly is within an octave, all that is darker than their chunk's mean being one: where a cluster stands for its
// patches, what is seen is that they differ, and most of that is direct light (town of 1M by night: RESULTS.md).
inline constexpr int kBrightLevels = 5;
static_assert(kBrightLevels <= formats::kChunkLog, "what a node gathers lies in one chunk of level 0");

// Openness class of a patch: 0 interior, 1 half open, 2 open, by the fraction of its rays that reach the sky; 3 and 4 an
// interior that is narrow (an alley, the space inside a thick wall) or very much so (a crevice): HitRows::narrow.
inline constexpr uint32_t kOpennesses = 5;
uint32_t openness(double sky_fraction, uint32_t narrow = 0);

struct Hierarchy {
  PagedVector<uint32_t> number;  // of patch p in level 0's order
  // parents[l][i]: number of node i's parent at level l + 1. One vector per level but the last.
  std::vector<PagedVector<uint32_t>> parents;
  std::vector<uint32_t> nodes;   // per level
  // tile_start[l]: first node of each tile, then the number of nodes. Siblings never straddle a tile.
  std::vector<std::vector<uint32_t>> tile_start;
  // tile_parents[l][t]: the tile of level l + 1 that holds the parents of all of tile t's nodes; non-decreasing.
  std::vector<std::vector<uint32_t>> tile_parents;
  // names[l][t]: of tile t. Child tiles of one tile lie in one chunk. Where a coarse cell has more nodes than a tile, the tiles of a chunk far below
  // do not follow each other: first those beneath one of its tiles, then those beneath the next.
  std::vector<std::vector<formats::TileName>> names;
  uint32_t levels() const { return static_cast<uint32_t>(nodes.size()); }
};

// Per patch: sky_fraction, narrow, lamp_light (what arrives of lamps directly, W/m2; 0: none); the latter two may be empty.
Hierarchy makeHierarchy(std::span<const Patch> patches, std::span<const float> sky_fraction,
                        std::span<const uint8_t> narrow = {}, std::span<const float> lamp_light = {});

// The level above: a tile's rows from those of its child tiles, on all of TBB's threads. `own` is filled. light: of all nodes of the level below,
// as rowFactor() asks for it; returns that of this level. done: counts tiles. Memory: of the tiles in work, and 9 bytes a node of the level for each thread.
PagedVector<LightValues> gatherClusters(const LevelRows& below, std::span<const LightValues> light, const Hierarchy& hierarchy, uint32_t level, LevelRows& own,
                                        WorkCount& done);

}  // namespace ff::bake
