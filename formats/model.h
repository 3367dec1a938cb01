// The words of the format in memory: nodes, strips, tiles, levels, worlds. FORMAT.md is the normative description of the
// bytes; strip_codec, manifest, reader and writer are the only places that turn one into the other.
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "formats/unset_vector.h"
#include "formats/vec3.h"

namespace ff::formats {

inline constexpr uint16_t kFormatVersion = 3;        // written, and the only one that this reader understands
inline constexpr uint32_t kMaxBlocks = 65535;       // of a strip: partner tiles, which solvers count in 16 bits
inline constexpr uint32_t kTileNodes = 256;          // nodes of a tile, at most: rows and columns are then one byte each
inline constexpr uint32_t kMaxLevels = 16;
inline constexpr uint32_t kMaxQuanta = 16383;        // of a row: counts are 14 bits in what solvers read
inline constexpr uint32_t kMaxRowFactor = 8;          // a row may have so many times the samples of the world's settings
inline constexpr uint32_t kNoParent = 0xffffffffu;
inline constexpr uint64_t kMaxLevelTiles = 0xfffffffeu;  // numbers of tiles have 32 bits in memory; those of nodes 64
inline constexpr uint16_t kNoLampGroup = 0xffff;
inline constexpr uint64_t kShardHeaderBytes = 4096;
inline constexpr uint32_t kNoShard = 0xffffffffu;

// Samples of a row, at most, in a world of `quanta`: what a reader's bounds on memory rest on. Writer and reader refuse more.
constexpr uint32_t maxRowQuanta(uint32_t quanta) { return quanta > kMaxQuanta / kMaxRowFactor ? kMaxQuanta : quanta * kMaxRowFactor; }

// A chunk is a cube of kChunkCells cells of one level a side, numbered from the grid's origin: cell >> kChunkLog. The eight chunks of level l
// that lie in one of level l + 1 are its children. What a file says of a tile it says relative to the tile's chunk.
inline constexpr int kChunkLog = 5;
inline constexpr int32_t kChunkCells = 1 << kChunkLog;
using ChunkCell = std::array<int32_t, 3>;
inline constexpr uint32_t kMaxChunkTiles = 65535;

// The name of a tile, beside its level: it depends on nothing outside the chunk.
struct TileName {
  ChunkCell chunk{};
  uint32_t tile = 0;  // number within the chunk
  friend bool operator==(const TileName&, const TileName&) = default;
};

// A tile of one level by its number in the world's order: chunk by chunk down the tree of chunks, children in their parent's order. A
// handle for memory, made from the index where it is read; no file holds it. Level 0 holds the patches.
struct TileId {
  uint32_t level = 0;
  uint32_t tile = 0;
  friend bool operator==(const TileId&, const TileId&) = default;
  friend auto operator<=>(const TileId&, const TileId&) = default;
};

inline constexpr float kMaxEmission = 1e12f;  // W/m2; the sun's own surface emits 6.3e7

// A patch (level 0) or a cluster of nodes of the level below. Siblings (nodes with one parent) lie in one tile. Tiles form a
// tree: the parents of a tile's nodes lie in one tile, and tiles of a level are in the order of these.
struct Node {
  float area_m2 = 0;
  Vec3 centroid;             // m
  Vec3 normal;               // unit area-weighted mean; zero where the pieces cancel
  Vec3 albedo;               // diffuse, 0..1, linear RGB
  Vec3 emission;             // M, radiosity emitted as baked, W/m2, linear RGB, 0..kMaxEmission
  uint16_t lamp_group = kNoLampGroup;  // whose switch scales the emission; nodes of two groups never share a parent
  // The row's closure: sum of the entries' counts + sky + absorbed == quanta, exactly.
  uint32_t quanta = 0;       // Q of this row: at most maxRowQuanta(WorldInfo::quanta)
  uint32_t sky = 0;          // quanta that reach the sky: they close the row; its light is told by sky_fraction
  uint32_t absorbed = 0;     // quanta lost: back faces
  float row_total = 1;       // the row's sum before it was scaled to its quanta: A_i row_total_i count/quanta is the
                             // exchange area with a column, and equal from both its ends but for sampling
  // The sky as a source of light, with the precision of all rays. A sky of radiance
  //   L(w) = l0 + dot(l1, w) + sum of l2[k] P_k(w),  P = {2xy, 2yz, 2zx, (3y^2 - 1) / 2, x^2 - z^2}
  // gives irradiance pi * sky_fraction * (l0 + dot(l1, sky_direction) + sum of l2[k] sky_quadratic[k]).
  float sky_fraction = 0;    // of the cosine-weighted hemisphere, 0..1
  Vec3 sky_direction;        // mean direction of what is seen of the sky, length <= 1
  std::array<float, 5> sky_quadratic{};  // means of P over the same, -1..1
};

// The light of a lamp group at a node: irradiance of channel c is group.emission[c] * weight[c], as baked. Lamps reach a node
// by these alone, whole; the sampled rows carry what surfaces reflect, lamps' own included.
struct LampLight {
  uint8_t row = 0;           // index into nodes
  uint16_t group = 0;        // index into WorldInfo::lamp_groups
  Vec3 weight;               // 0..2: the group's form factor, weighted by how bright each of its patches is; an estimate, so
                             // that it may lie a little above 1
};

// The entries of a strip whose columns lie in one partner tile (of the strip's own level).
struct Block {
  uint32_t partner_tile = 0;  // of the strip's own level
  uint32_t entries = 0;
};

// All rows of one tile. Entries are sorted by (partner tile, row, column); blocks, at most kMaxBlocks, follow each other in `rows`, `columns`
// and `counts`. Form factor of an entry: F = count / nodes[row].quanta, receiver = row, source = column.
struct Strip {
  TileId id;
  uint64_t first_node = 0;        // number of nodes[0] within its level
  std::vector<Node> nodes;        // 1..kTileNodes
  std::vector<Block> blocks;      // partner_tile ascending, entries > 0
  std::vector<uint8_t> rows;      // index into nodes
  std::vector<uint8_t> columns;   // index into the partner tile's nodes
  std::vector<uint16_t> counts;   // >= 1
  std::vector<LampLight> lamps;   // by (row, group), ascending
};

// A strip's entries in the form in which solvers read them: row r has the runs runs[run_start[r] .. run_start[r + 1]), one a partner
// tile, and the words words[row_start[r] .. row_start[r + 1]), run after run. A word is `column << 8 | count`; a count above
// kMaxWordCount takes several with one column.
inline constexpr uint32_t kMaxWordCount = 255;
struct RowWords {
  struct Run {
    uint16_t partner;  // index into the strip's blocks, ascending in a row
    uint16_t words;
  };
  UnsetVector<Run> runs;
  UnsetVector<uint16_t> words;
  std::vector<uint32_t> run_start, row_start;  // nodes + 1 each
  std::vector<uint64_t> row_partners;          // per node: bit p % 64 is set for each partner p of its runs
};

// Drawing geometry of a level-0 tile: a triangle soup that covers its patches. Positions in metres. The last triangles are no part of
// a patch but of the sealed surface that it goes on in, which no light gets to: drawn with the patch's light, they close gaps.
struct TileGeometry {
  uint32_t tile = 0;
  std::vector<Vec3> positions;      // 3 per triangle
  std::vector<uint8_t> patch;       // one per triangle: index of the patch in the tile
  uint32_t sealed = 0;              // so many triangles at the end are of sealed surface
  size_t exposed() const { return patch.size() - sealed; }  // triangles of the patches themselves: the first
};

// Where bytes lie, and what they must be.
struct Extent {
  uint32_t shard = kNoShard;     // index into World::shards
  uint64_t offset = 0;           // bytes from the start of the shard
  uint32_t stored_bytes = 0;
  uint32_t raw_bytes = 0;        // of what is compressed in them
  uint64_t checksum = 0;         // XXH3-64 of the stored bytes
  friend bool operator==(const Extent&, const Extent&) = default;
};

// Where a tile's strip lies and what it covers.
struct TileInfo {
  TileId id;
  Extent strip;                  // header and compressed payload
  uint64_t first_node = 0;       // number within the level, in the order of tiles
  uint32_t nodes = 0;
  uint32_t entries = 0;
  uint32_t parent_tile = kNoParent;  // tile of the level above that holds the parents of all of its nodes
  uint32_t first_child = 0, end_child = 0;  // tiles of the level below whose parent tile this is: first, last + 1
  Box bounds;                    // m, of the tile's patches (surfaces, not just centroids)
};

// Drawing geometry of a tile.
struct GeometryInfo {
  Extent strip;
  uint32_t triangles = 0;
};

struct LevelInfo {
  uint64_t nodes = 0;
  uint32_t tiles = 0;
  uint64_t entries = 0;
  uint64_t stored_bytes = 0;     // strips, and the index of their chunks
  float cell_m = 0;              // edge of this level's grid cell
};

// Emitters that are switched together: those of one material, or of nodes that the scene file groups by name.
struct LampGroup {
  std::string name;
  Vec3 emission;                 // W/m2: the largest of its patches', a channel at a time
  double area_m2 = 0;
  uint32_t patches = 0;
};

// A light of the source file that is no surface (glTF's KHR_lights_punctual), in world space. Its light is direct light, an
// input at run time: the rows do not hold it.
struct Light {
  enum Kind : uint8_t { kDirectional = 0, kPoint = 1, kSpot = 2 };
  std::string name;
  uint8_t kind = kPoint;
  Vec3 color_intensity;          // linear RGB >= 0: irradiance in W/m2 of a directional light, else radiant intensity in W/sr
  Vec3 position;                 // m; not of a directional light
  Vec3 direction;                // unit, the way the light goes; zero for a point light
  float range_m = 0;             // 0: without end
  float inner_angle = 0;         // of a spot, radians from its direction: full light within `inner_angle`, none beyond
  float outer_angle = 0;         // `outer_angle`; 0 <= inner < outer <= pi / 2
  friend bool operator==(const Light&, const Light&) = default;
};

// What the baker was told and what it measured; the head of the manifest.
struct WorldInfo {
  float cell_m = 1;              // patch size
  std::array<double, 3> origin{};  // m, in the source's world space: where all coordinates here count from, and the corner of cell
                                 // (0,0,0) of every level; cell = floor(p / cell_m). Zero but for scenes that stand far away.
  Box bounds;                    // m
  uint32_t rays = 0;             // per patch, on average
  uint32_t fewest_rays = 0;      // of any patch
  float target_error = 0;        // that rays were cast for, of the light of 99 of 100 rows at most, relative; 0: all patches cast as many
  float row_error = 0;           // the same, as measured, by the rays themselves
  uint8_t preview = 0;           // 1: baked in seconds to look at, with few large patches and few rays
  uint32_t quanta = 0;           // Q: samples of a row, by rule; see maxRowQuanta
  uint64_t seed = 0;
  std::array<uint8_t, 16> bake_key{};   // XXH3-128 of scene bytes, settings and code version
  std::string generator;         // "ffbake 0.1.0"
  std::string scene;             // file name without folders
  float row_total_deviation = 0; // largest |1 - sum of a row before it was scaled to Q|: the slack of reciprocity
  double area_m2 = 0;
  uint64_t triangles = 0;
  double absorbed_fraction = 0;  // area-weighted: leak diagnostic
  std::vector<LampGroup> lamp_groups;
  std::vector<Light> lights;     // of the source file
};

}  // namespace ff::formats
