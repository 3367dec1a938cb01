// A made-up world whose answers are known: patches on a square of unit cells with holes, clusters of
// 2x2 cells, tiles that are a tree but do not follow the Morton order of cells, and rows drawn at random (mostly near columns). Coarse rows are the exact aggregates of the patches' rows
// when areas are equal: with A and Q the same everywhere, A_I F_IJ = sum of A_i F_ij becomes a sum of integer counts.
// A tenth of the patches emit, in three lamp groups; their light is what the patches' rows would bring of it.
#pragma once
#include "tests/support/random_world.h"

namespace ff::stream {

struct SyntheticSettings {
  uint32_t side = 32;  // cells along the square, a power of two
  uint32_t levels = 4;
  uint32_t tile_nodes = 32;  // at most, so that a small world has many tiles
  uint32_t quanta = 48;      // of a patch; a cluster has the sum of its patches', which formats::kMaxQuanta bounds
  double far_share = 0.2;    // of a row's quanta that go anywhere rather than near
  double sky_share = 0.3;    // of a row's quanta; 0: closed
  double hole_share = 0.2;   // of the cells that hold no patch
  bool equal_areas = true;   // else random, and coarse rows are aggregates of counts only
  float albedo = -1;         // negative: random
  int without_lamps = -1;    // the lamp group that does not emit; negative: all do
  uint64_t seed = 1;
};

formats::RandomWorld makeSyntheticWorld(const SyntheticSettings& settings);

}  // namespace ff::stream
