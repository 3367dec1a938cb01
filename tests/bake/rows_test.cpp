// Pooling, row sampling and the pyramid against brute force.
#include <gtest/gtest.h>

#include <map>
#include <random>
#include <set>

#include "bake/matrix/pool.h"
#include "bake/matrix/pyramid.h"
#include "bake/matrix/row_sampling.h"
#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

CastScene room() { return cast(closedBox({.5f, .5f, .5f}, {}), 0.125f, 512); }

std::vector<float> areasOf(const CastScene& c) {
  std::vector<float> areas;
  for (const Patch& p : c.set.patches) areas.push_back(p.area_m2);
  return areas;
}

// Patches by their nodes of level 1.
std::vector<std::vector<uint32_t>> childrenOf(const Hierarchy& h) {
  std::vector<std::vector<uint32_t>> children(h.nodes[1]);
  for (uint32_t i = 0; i < h.parents[0].size(); ++i) children[h.parents[0][i]].push_back(i);
  return children;
}

TEST(Pool, ExchangeAreasAreSymmetricAndPoolAllHits) {
  const CastScene c = room();
  const auto n = static_cast<uint32_t>(c.set.patches.size());
  const PooledPatches pooled(c.rows, areasOf(c));
  struct Hits {
    uint32_t count = 0, estimate = 0;
    bool whole = false;
    double rays() const { return estimate > 0 ? estimate / kRayParts : count; }
  };
  std::map<std::pair<uint32_t, uint32_t>, Hits> hits;
  for (uint32_t i = 0; i < n; ++i)
    for (uint64_t k = c.rows.start[i]; k < c.rows.start[i + 1]; ++k) hits[{i, c.rows.column[k]}] = {c.rows.count[k], c.rows.estimate[k], c.rows.whole[k] > 0};
  std::map<std::pair<uint32_t, uint32_t>, double> exchange;
  ExchangeRow row;
  for (uint32_t i = 0; i < n; ++i) {
    pooled.row(i, row);
    for (size_t k = 0; k < row.column.size(); ++k) exchange[{i, row.column[k]}] = row.area_m2[k];
  }
  int counted = 0, one_end = 0, both = 0;
  for (const auto& [pair, x] : exchange) {
    const auto [i, j] = pair;
    const double a = static_cast<double>(c.set.patches[i].area_m2), b = static_cast<double>(c.set.patches[j].area_m2);
    const Hits of_i = hits[pair], of_j = hits[{j, i}];
    const double density_i = of_i.estimate > 0 ? 512 / a : 0, density_j = of_j.estimate > 0 ? 512 / b : 0;  // of the ends where geometry tells
    const double expected = of_i.whole || of_j.whole ? (of_i.estimate + of_j.estimate) / kRayParts / (density_i + density_j)
                                                     : (of_i.rays() + of_j.rays()) / (512 / a + 512 / b);
    EXPECT_DOUBLE_EQ(x, expected);
    EXPECT_DOUBLE_EQ(x, exchange.at({j, i}));
    counted += of_i.estimate + of_j.estimate == 0;
    EXPECT_EQ(of_i.whole || of_j.whole, of_i.estimate + of_j.estimate > 0) << "in an empty room";
    one_end += (of_i.estimate > 0) != (of_j.estimate > 0);
    both += of_i.estimate > 0 && of_j.estimate > 0;
  }
  for (const auto& [pair, of] : hits) EXPECT_TRUE(of.count == 0 || exchange.contains(pair));
  EXPECT_GT(std::min({counted, one_end, both}), 100);  // of each kind
}

TEST(Pool, HalvesTheVarianceOfARow) {
  // Between two equal facing patches both ends cast the same number of rays; the error of many pooled estimates against
  // a 64 times finer one shrinks by about the square root of two.
  CastScene coarse = cast(closedBox({.5f, .5f, .5f}, {}), 0.25f, 256), fine = cast(closedBox({.5f, .5f, .5f}, {}), 0.25f, 16384, 9);
  for (CastScene* c : {&coarse, &fine}) c->rows = counts(c->rows);  // as if geometry told nothing
  const PooledPatches pooled(coarse.rows, areasOf(coarse)), truth(fine.rows, areasOf(fine));
  double raw_error = 0, pooled_error = 0;
  ExchangeRow p, t;
  for (uint32_t i = 0; i < coarse.set.patches.size(); ++i) {
    const double area = static_cast<double>(coarse.set.patches[i].area_m2);
    std::map<uint32_t, double> f_raw, f_pooled;
    for (uint64_t k = coarse.rows.start[i]; k < coarse.rows.start[i + 1]; ++k)
      f_raw[coarse.rows.column[k]] = coarse.rows.count[k] / 256.0;
    pooled.row(i, p);
    for (size_t k = 0; k < p.column.size(); ++k) f_pooled[p.column[k]] = p.area_m2[k] / area;
    truth.row(i, t);
    for (size_t k = 0; k < t.column.size(); ++k) {
      const double f = t.area_m2[k] / area;
      raw_error += std::pow(f_raw[t.column[k]] - f, 2);
      pooled_error += std::pow(f_pooled[t.column[k]] - f, 2);
    }
  }
  EXPECT_LT(pooled_error, 0.65 * raw_error);
}

TEST(RowSampling, CountsSumToQExactlyAndEachIsWithinOneOfItsExpectation) {
  const CastScene c = room();
  const PooledPatches pooled(c.rows, areasOf(c));
  ExchangeRow row;
  SampledRow out;
  for (uint32_t q : {1u, 7u, 64u, 512u, 65535u})
    for (uint32_t i = 0; i < pooled.nodes(); i += 7) {
      pooled.row(i, row);
      row.sky_m2 = 0.001 * i;
      row.absorbed_m2 = i % 3 == 0 ? 0.002 : 0;
      const double offset = (i % 10) / 10.0;
      sampleRow(row, c.set.patches[i].area_m2, q, offset, out);
      double sum = row.sky_m2 + row.absorbed_m2;
      for (double x : row.area_m2) sum += x;
      std::map<uint32_t, double> expected;
      for (size_t k = 0; k < row.column.size(); ++k) expected[row.column[k]] = row.area_m2[k] / sum * q;
      uint32_t total = out.sky + out.absorbed;
      for (size_t k = 0; k < out.column.size(); ++k) {
        ASSERT_TRUE(expected.contains(out.column[k]));
        EXPECT_LT(std::abs(out.count[k] - expected[out.column[k]]), 1 + 1e-6);
        EXPECT_GE(out.count[k], 1u);
        total += out.count[k];
      }
      EXPECT_EQ(total, q);
      EXPECT_LT(std::abs(out.sky - row.sky_m2 / sum * q), 1 + 1e-6);
    }
}

TEST(RowSampling, IsUnbiasedOverItsOffset) {
  ExchangeRow row;
  for (uint32_t j = 0; j < 50; ++j) {
    row.column.push_back(j);
    row.area_m2.push_back(0.001 + 0.0007 * j * (j % 4));
  }
  row.sky_m2 = 0.3;
  double sum = row.sky_m2;
  for (double x : row.area_m2) sum += x;
  constexpr int kOffsets = 4096;
  std::vector<double> mean(50, 0);
  SampledRow out;
  for (int k = 0; k < kOffsets; ++k) {
    sampleRow(row, 1, 16, (k + 0.5) / kOffsets, out);
    for (size_t e = 0; e < out.column.size(); ++e) mean[out.column[e]] += static_cast<double>(out.count[e]) / kOffsets;
  }
  // As a function of the offset each count is a step function: the midpoint rule errs by at most one step.
  for (uint32_t j = 0; j < 50; ++j) EXPECT_NEAR(mean[j], row.area_m2[j] / sum * 16, 2.0 / kOffsets) << j;
}

TEST(RowSampling, ARowThatSeesNothingIsAbsorbed) {
  ExchangeRow row;
  SampledRow out;
  sampleRow(row, 1, 512, 0.5, out);
  EXPECT_EQ(out.absorbed, 512u);
  EXPECT_EQ(out.sky, 0u);
}

TEST(Pyramid, SiblingsShareCellAndOrientationAndLieInOneTile) {
  const CastScene c = cast(closedBox({.5f, .5f, .5f}, {}), 0.03125f, 16);
  std::vector<float> sky(c.set.patches.size());
  for (size_t i = 0; i < sky.size(); ++i) sky[i] = i % 5 == 0 ? 0.5f : 0.0f;
  const Hierarchy h = makeHierarchy(c.set.patches, sky);
  ASSERT_GE(h.levels(), 2u);
  EXPECT_LE(h.nodes.back(), kTopNodes);
  std::vector<uint32_t> patch_of(sky.size());
  for (uint32_t p = 0; p < sky.size(); ++p) patch_of[h.number[p]] = p;
  for (uint32_t l = 0; l + 1 < h.levels(); ++l) {
    const auto &tiles = h.tile_start[l], &above = h.tile_start[l + 1];
    std::vector<std::set<uint32_t>> child_tiles(h.nodes[l + 1]);
    for (uint32_t t = 0; t + 1 < tiles.size(); ++t) {
      const uint32_t parents = h.tile_parents[l][t];
      EXPECT_TRUE(t == 0 || parents == h.tile_parents[l][t - 1] || parents == h.tile_parents[l][t - 1] + 1);
      for (uint32_t i = tiles[t]; i < tiles[t + 1]; ++i) {
        const uint32_t p = h.parents[l][i];
        EXPECT_TRUE(above[parents] <= p && p < above[parents + 1]) << "parents of a tile lie in two";
        child_tiles[p].insert(t);
      }
    }
    for (const auto& of_parent : child_tiles) EXPECT_EQ(of_parent.size(), 1u) << "siblings are parted, or a parent has no child";
  }
  const auto children = childrenOf(h);
  for (uint32_t n = 0; n < h.nodes[1]; ++n)
    for (const uint32_t i : children[n]) {
      const uint32_t first = patch_of[children[n][0]];
      const Patch &a = c.set.patches[patch_of[i]], &b = c.set.patches[first];
      EXPECT_EQ(hilbertAncestor(a.key, 1), hilbertAncestor(b.key, 1));
      EXPECT_EQ(a.orientation, b.orientation);
      EXPECT_EQ(openness(static_cast<double>(sky[patch_of[i]])), openness(static_cast<double>(sky[first])));
    }
  for (const auto& tiles : h.tile_start)
    for (size_t t = 0; t + 1 < tiles.size(); ++t) EXPECT_LE(tiles[t + 1] - tiles[t], formats::kTileNodes);
}

// A shadow, or a lamp, elsewhere gives a patch another cluster; rows that name it name it as before.
TEST(Pyramid, WhatPatchesSeeDoesNotMoveThemInTheirTile) {
  const CastScene c = cast(closedBox({.5f, .5f, .5f}, {}), 0.03125f, 16);
  const size_t n = c.set.patches.size();
  std::vector<float> sky(n, 0.5f);
  std::vector<float> lamp_light(n, 0);
  const Hierarchy before = makeHierarchy(c.set.patches, sky, {}, lamp_light);
  for (size_t i = 0; i < n; i += 7) sky[i] = 0.1f;
  for (size_t i = 0; i < n; i += 11) lamp_light[i] = 1;
  const Hierarchy after = makeHierarchy(c.set.patches, sky, {}, lamp_light);
  EXPECT_GT(after.nodes[1], before.nodes[1]);
  EXPECT_EQ(after.number, before.number);
  EXPECT_EQ(after.tile_start[0], before.tile_start[0]);
}

// Ground with blocks of many heights, all of them 1-cell patches, `side` cells wide.
std::vector<Patch> townPatches(int32_t side) {
  std::vector<Patch> patches;
  const auto add = [&](Cell cell, uint32_t orientation) {
    Patch p;
    p.cell = cell;
    p.key = hilbertKey(cell);
    p.orientation = orientation;
    patches.push_back(p);
  };
  for (int32_t x = 0; x < side; ++x)
    for (int32_t z = 0; z < side; ++z) {
      const int32_t height = x / 8 % 2 && z / 8 % 2 ? 4 + (x / 8 * 7 + z / 8 * 5) % 13 : 0;
      add({x, height, z}, 2);
      for (int32_t y = 0; y < height; ++y) {
        if (x % 8 == 0) add({x - 1, y, z}, 1);
        if (x % 8 == 7) add({x + 1, y, z}, 0);
        if (z % 8 == 0) add({x, y, z - 1}, 5);
        if (z % 8 == 7) add({x, y, z + 1}, 4);
      }
    }
  return patches;
}

// 300 lamp groups everywhere: at the coarsest level one cell has more nodes than a tile, so that chunks far below come once for each of its tiles.
TEST(Pyramid, NamesAreUniqueWhereACoarseCellHasMoreNodesThanATile) {
  std::vector<Patch> patches;
  for (int32_t x = 0; x < 128; ++x)
    for (int32_t z = 0; z < 128; ++z) {
      Patch p;
      p.cell = {x, 0, z};
      p.key = hilbertKey(p.cell);
      p.lamp_group = static_cast<uint16_t>((x * 37 + z) % 300);
      patches.push_back(p);
    }
  const Hierarchy h = makeHierarchy(patches, std::vector<float>(patches.size(), 0.5f));
  size_t came_back = 0;
  for (uint32_t l = 0; l < h.levels(); ++l) {
    std::set<std::pair<formats::ChunkCell, uint32_t>> names;
    for (size_t t = 0; t < h.names[l].size(); ++t) {
      const formats::TileName& name = h.names[l][t];
      EXPECT_TRUE(names.insert({name.chunk, name.tile}).second) << "level " << l << ", tile " << t;
      came_back += name.tile > 0 && t > 0 && h.names[l][t - 1].chunk != name.chunk;
    }
  }
  EXPECT_GT(came_back, 0u);
}

TEST(Pyramid, ATileIsAtMostSixteenCellsWideWhateverTheWorldAndHoldsAllClassesOfItsPlace) {
  for (const int32_t side : {96, 400}) {
    const std::vector<Patch> patches = townPatches(side);
    const Hierarchy h = makeHierarchy(patches, std::vector<float>(patches.size(), 0.5f));
    ASSERT_GE(h.levels(), 3u);
    std::vector<std::array<int32_t, 3>> lo(patches.size()), hi(patches.size());  // of each node
    for (size_t p = 0; p < patches.size(); ++p) lo[h.number[p]] = hi[h.number[p]] = patches[p].cell;
    for (uint32_t l = 0; l < h.levels(); ++l) {
      std::map<std::array<int32_t, 3>, std::set<uint32_t>> tiles_of_family_cell;
      for (uint32_t t = 0; t + 1 < h.tile_start[l].size(); ++t) {
        std::array<int32_t, 3> low{1 << 20, 1 << 20, 1 << 20}, high{-(1 << 20), -(1 << 20), -(1 << 20)};
        for (uint32_t i = h.tile_start[l][t]; i < h.tile_start[l][t + 1]; ++i) {
          std::array<int32_t, 3> family{};
          for (size_t a = 0; a < 3; ++a) {
            low[a] = std::min(low[a], lo[i][a] >> l);
            high[a] = std::max(high[a], hi[i][a] >> l);
            family[a] = lo[i][a] >> (l + 1);
          }
          tiles_of_family_cell[family].insert(t);
        }
        for (size_t a = 0; a < 3; ++a) EXPECT_LT(high[a] - low[a], 16) << side << ", level " << l << ", tile " << t;
      }
      if (l + 1 == h.levels()) break;
      for (const auto& [cell, tiles] : tiles_of_family_cell) EXPECT_EQ(tiles.size(), 1u);
      const auto tiles = static_cast<double>(h.tile_start[l].size() - 1);
      EXPECT_GT(h.nodes[l] / tiles, 0.4 * formats::kTileNodes) << "tiles are small";
      std::vector<std::array<int32_t, 3>> low(h.nodes[l + 1], {1 << 20, 1 << 20, 1 << 20}), high(h.nodes[l + 1], {-(1 << 20), -(1 << 20), -(1 << 20)});
      for (uint32_t i = 0; i < h.nodes[l]; ++i)
        for (size_t a = 0; a < 3; ++a) {
          low[h.parents[l][i]][a] = std::min(low[h.parents[l][i]][a], lo[i][a]);
          high[h.parents[l][i]][a] = std::max(high[h.parents[l][i]][a], hi[i][a]);
        }
      lo = std::move(low);
      hi = std::move(high);
    }
  }
}

TEST(Pyramid, TheOrderIsAFunctionOfPlaceAndClassAlone) {
  std::vector<Patch> patches = townPatches(96);
  const std::vector<float> sky(patches.size(), 0.5f);
  const auto ordered = [&] {
    const Hierarchy h = makeHierarchy(patches, sky);
    std::vector<std::pair<uint64_t, uint32_t>> order(patches.size());
    for (size_t p = 0; p < patches.size(); ++p) order[h.number[p]] = {patches[p].key, patches[p].orientation};
    return std::pair{order, h.tile_start};
  };
  const auto before = ordered();
  std::shuffle(patches.begin(), patches.end(), std::mt19937(1));
  EXPECT_EQ(ordered(), before);
}

TEST(Pyramid, LampsAndNarrowPlacesHaveClustersOfTheirOwn) {
  CastScene c = cast(closedBox({.5f, .5f, .5f}, {}), 0.03125f, 16);
  std::vector<float> sky(c.set.patches.size(), 0);
  std::vector<uint8_t> narrow(sky.size());
  for (size_t i = 0; i < sky.size(); ++i) {
    c.set.patches[i].lamp_group = i % 7 == 0 ? static_cast<uint16_t>(i % 2) : formats::kNoLampGroup;
    narrow[i] = static_cast<uint8_t>(i % 3);
  }
  const Hierarchy h = makeHierarchy(c.set.patches, sky, narrow);
  ASSERT_GE(h.levels(), 2u);
  std::vector<uint32_t> patch_of(sky.size());
  for (uint32_t p = 0; p < sky.size(); ++p) patch_of[h.number[p]] = p;
  const auto children = childrenOf(h);
  for (uint32_t i = 0; i < sky.size(); ++i) {
    const uint32_t a = patch_of[i], b = patch_of[children[h.parents[0][i]][0]];
    EXPECT_EQ(c.set.patches[a].lamp_group, c.set.patches[b].lamp_group);
    EXPECT_EQ(narrow[a], narrow[b]);
  }
}

// A town of 512 x 512 cells, and what lamps 24 cells apart and 4 cells above the ground give each patch, W/m2, as if nothing stood between; beyond 12 cells nothing.
struct LampLitTown {
  std::vector<Patch> patches = townPatches(512);
  std::vector<float> sky = std::vector<float>(patches.size(), 0.5f), lamp_light = std::vector<float>(patches.size());
  LampLitTown() {
    for (size_t i = 0; i < patches.size(); ++i) {
      patches[i].area_m2 = 1;
      const auto off = [](int32_t at) { return static_cast<float>(at % 24 - 12); };
      const float x = off(patches[i].cell[0] + 24), y = static_cast<float>(patches[i].cell[1] - 4), z = off(patches[i].cell[2] + 24), square = x * x + y * y + z * z + 0.3f;
      if (square < 144) lamp_light[i] = 40 / square;
    }
  }
  formats::ChunkCell chunk(size_t patch) const {
    const Cell& cell = patches[patch].cell;
    return {cell[0] >> formats::kChunkLog, cell[1] >> formats::kChunkLog, cell[2] >> formats::kChunkLog};
  }
};

TEST(Pyramid, ClustersUpToABrightLevelHaveLightOfOneOctave) {
  const LampLitTown town;
  std::map<formats::ChunkCell, std::pair<double, double>> lit;  // power and area of what is lit in a chunk
  for (size_t i = 0; i < town.patches.size(); ++i)
    if (town.lamp_light[i] > 0) {
      lit[town.chunk(i)].first += static_cast<double>(town.lamp_light[i]);
      lit[town.chunk(i)].second += 1;
    }
  const Hierarchy h = makeHierarchy(town.patches, town.sky, {}, town.lamp_light);
  ASSERT_GT(h.levels(), static_cast<uint32_t>(kBrightLevels) + 1);
  std::vector<uint32_t> node(h.number.begin(), h.number.end());  // of each patch
  for (uint32_t level = 1; level < h.levels(); ++level) {
    std::vector<std::pair<float, float>> range(h.nodes[level], {1e9f, 0.0f});  // darkest and brightest patch of each
    std::vector<double> mean(h.nodes[level]);
    for (size_t i = 0; i < node.size(); ++i) {
      node[i] = h.parents[level - 1][node[i]];
      auto& [least, most] = range[node[i]];
      least = std::min(least, town.lamp_light[i]);
      most = std::max(most, town.lamp_light[i]);
      if (town.lamp_light[i] > 0) mean[node[i]] = lit[town.chunk(i)].first / lit[town.chunk(i)].second;
    }
    size_t uneven = 0, dim = 0;
    for (size_t k = 0; k < range.size(); ++k) {
      const auto [least, most] = range[k];
      EXPECT_EQ(least > 0, most > 0) << "a node of level " << level << " is lit in part";
      uneven += most >= 2 * least && static_cast<double>(most) > mean[k];
      dim += most >= 2 * least && static_cast<double>(most) <= mean[k];
    }
    EXPECT_EQ(uneven > 0, level > static_cast<uint32_t>(kBrightLevels)) << level << ": " << uneven;
    EXPECT_GT(dim, 0u) << "what is dark is split for nothing";
  }
}

// So rows elsewhere name patches of a place as before when a house comes to stand between it and a lamp.
TEST(Pyramid, ShadowsOfLampsDoNotChangeWhichPatchesMakeUpATile) {
  LampLitTown town;
  const Hierarchy before = makeHierarchy(town.patches, town.sky, {}, town.lamp_light);
  for (size_t i = 0; i < town.patches.size(); ++i)
    if (town.patches[i].cell[0] % 24 / 4 == 1 && town.patches[i].cell[2] % 24 >= 12) town.lamp_light[i] *= 0.2f;
  const Hierarchy after = makeHierarchy(town.patches, town.sky, {}, town.lamp_light);
  EXPECT_NE(after.nodes[1], before.nodes[1]);
  EXPECT_EQ(after.number, before.number);
  EXPECT_EQ(after.tile_parents[0], before.tile_parents[0]);
  EXPECT_EQ(after.tile_start[0], before.tile_start[0]);
}

TEST(Pyramid, LampsOfOneChunkPartNoClustersOfAnother) {
  LampLitTown town;
  const auto clustersOf = [&](const formats::ChunkCell& chunk) {
    const Hierarchy h = makeHierarchy(town.patches, town.sky, {}, town.lamp_light);
    std::map<uint32_t, std::set<size_t>> by_parent;
    for (size_t i = 0; i < town.patches.size(); ++i)
      if (town.chunk(i) == chunk) by_parent[h.parents[0][h.number[i]]].insert(i);
    std::set<std::set<size_t>> clusters;
    for (auto& [parent, patches] : by_parent) clusters.insert(std::move(patches));
    return clusters;
  };
  const formats::ChunkCell here{0, 0, 0}, there{2, 0, 2};
  const auto before_here = clustersOf(here), before_there = clustersOf(there);
  ASSERT_GT(before_here.size(), 100u);
  for (size_t i = 0; i < town.patches.size(); ++i)
    if (town.chunk(i) == there && town.patches[i].cell[0] % 3 == 0) town.lamp_light[i] *= 50;
  EXPECT_NE(clustersOf(there), before_there);
  EXPECT_EQ(clustersOf(here), before_here);
}

TEST(FormFactor, APlaceIsNarrowWhereMostRaysEndWithinFourCellsAndMoreSoWithinOne) {
  // Between two plates `gap` cells apart a ray at angle t to the normal is gap / cos t long: of cosine-weighted rays a
  // share 1 - (gap / reach)^2 ends within reach.
  for (const auto& [gap, steps] : {std::pair{0.5f, 2}, {0.8f, 1}, {2.3f, 1}, {2.8f, 0}}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
    addQuad(s, {0, 0.01f, 0}, {0, 0.01f, 16}, {16, 0.01f, 16}, {16, 0.01f, 0}, m);
    addQuad(s, {0, 0.01f + gap, 0}, {16, 0.01f + gap, 0}, {16, 0.01f + gap, 16}, {0, 0.01f + gap, 16}, m);
    const CastScene c = cast(std::move(s), 1, 256);
    for (uint32_t p = 0; p < c.set.patches.size(); ++p) {
      const Vec3 at = c.set.patches[p].centroid;
      if (std::min({at.x, at.z, 16 - at.x, 16 - at.z}) > 5) {
        EXPECT_EQ(c.rows.narrow[p], steps) << gap << " cells";
      }
    }
  }
}

// A floor and another surface that lies in its plane over a part of it, under a ceiling: rays meet the one or the other, as rounding has it.
TEST(FormFactor, SurfaceThatLiesInOnePlaneWithAnotherCountsOnce) {
  constexpr float kY = 0.1f, kFrom = 0.3f, kOut = 1.3f;
  for (const bool other_first : {false, true})
    for (const bool is_lamp : {false, true})
      for (const bool double_sided : {false, true}) {
        Scene s;
        const uint32_t floor = addMaterial(s, {.5f, .5f, .5f}), other = addMaterial(s, {.2f, .2f, .2f}, is_lamp ? Vec3{1, 1, 1} : Vec3{});
        s.materials[floor].double_sided = s.materials[other].double_sided = double_sided;
        const auto addFloor = [&] { addQuad(s, {0, kY, 0}, {0, kY, 1}, {1, kY, 1}, {1, kY, 0}, floor); };
        if (!other_first) addFloor();
        addQuad(s, {kFrom, kY, 0}, {kFrom, kY, 1}, {kOut, kY, 1}, {kOut, kY, 0}, other);
        if (other_first) addFloor();
        const uint32_t ceiling = addMaterial(s, {.5f, .5f, .5f});
        addQuad(s, {0, 1 + kY, 0}, {1, 1 + kY, 0}, {1, 1 + kY, 1}, {0, 1 + kY, 1}, ceiling);
        const CastScene c = cast(std::move(s), 0.25f, 2048);
        const std::vector<float> areas = areasOf(c);
        const PooledPatches pooled(c.rows, areas);
        double exchange = 0;  // of the ceiling and what is above the unit square
        ExchangeRow row;
        for (uint32_t i = 0; i < c.set.patches.size(); ++i) {
          pooled.row(i, row);
          EXPECT_NEAR(row.total_m2() / static_cast<double>(areas[i]), 1, 0.1);
          if (materialOf(c, i) != ceiling) continue;
          for (size_t k = 0; k < row.column.size(); ++k)
            if (c.set.patches[row.column[k]].normal.y > 0 && c.set.patches[row.column[k]].centroid.x < 1) exchange += row.area_m2[k];
        }
        std::array<double, 3> area{};  // by material
        for (const PatchTriangle& t : c.set.triangles) area[c.scene.triangles[t.source].material] += static_cast<double>(length(cross(t.b - t.a, t.c - t.a))) / 2;
        const double sides = double_sided ? 2 : 1;
        const bool other_stays = other_first || is_lamp;
        EXPECT_NEAR(area[floor], sides * (other_stays ? static_cast<double>(kFrom) : 1), 1e-3);
        EXPECT_NEAR(area[other], sides * (other_stays ? 1 : static_cast<double>(kOut) - 1), 1e-3);
        EXPECT_NEAR(exchange, 0.199825, 0.004);  // of two unit squares at distance 1, closed form
      }
}

// A foot of a chair with a slit in its side stands on a floor, a double-sided sheet; in the foot there may be a plate that touches nothing. No crumb of its
// inside joins the floor's other side, which faces as it does, so that nothing above the floor sees what is below.
TEST(FormFactor, NoLightGetsIntoAFootFromUnderTheFloorThatItStandsOn) {
  for (const auto& [size, floating] : {std::pair{0.02f, false}, {0.05f, false}, {0.2f, false}, {0.1f, true}, {0.2f, true}}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.9f, .9f, .9f});
    s.materials[m].double_sided = true;
    constexpr float kY = 0.5f;
    addQuad(s, {0, kY, 0}, {0, kY, 1}, {1, kY, 1}, {1, kY, 0}, m);
    const Vec3 lo{.2f, kY, .6f}, hi = lo + Vec3{size, size, size};
    const auto addSide = [&](float x0, float z0, float x1, float z1, float top) { addQuad(s, {x0, kY, z0}, {x1, kY, z1}, {x1, top, z1}, {x0, top, z0}, m); };
    addSide(lo.x, lo.z, lo.x, hi.z, hi.y);
    addSide(hi.x, lo.z, hi.x, hi.z, hi.y);
    addSide(lo.x, lo.z, hi.x, lo.z, hi.y);
    addSide(lo.x, hi.z, hi.x, hi.z, hi.y - 0.2f * size);
    addQuad(s, {lo.x, hi.y, lo.z}, {lo.x, hi.y, hi.z}, {hi.x, hi.y, hi.z}, {hi.x, hi.y, lo.z}, m);
    if (floating) {
      const float y = kY + 0.5f * size, in = 0.2f * size;
      addQuad(s, {lo.x + in, y, lo.z + in}, {lo.x + in, y, hi.z - in}, {hi.x - in, y, hi.z - in}, {hi.x - in, y, lo.z + in}, m);
    }
    const CastScene c = cast(std::move(s), 1, 4096);
    const uint32_t below = c.set.patchAt(0, false, {.6f, kY, .8f});
    ASSERT_LT(below, c.set.patches.size());
    EXPECT_NEAR(c.set.patches[below].area_m2, 1, 1e-4);
    const PooledPatches pooled(c.rows, areasOf(c));
    ExchangeRow row;
    pooled.row(below, row);
    EXPECT_TRUE(row.column.empty()) << size;
  }
}

TEST(FormFactor, WhatOfASheetIsInAClosedBoxTakesNoPart) {
  // A closed box with a tongue through its side, half in and half out.
  Scene s;
  const uint32_t m = addMaterial(s, {.9f, .9f, .9f});
  s.materials[m].double_sided = true;
  addBlock(s, {0.3f, 0.3f, 0.3f}, {0.6f, 0.6f, 0.6f}, m);
  addQuad(s, {0.45f, 0.4f, 0.5f}, {0.45f, 0.4f, 0.7f}, {0.5f, 0.4f, 0.7f}, {0.5f, 0.4f, 0.5f}, m);
  const CastScene c = cast(std::move(s), 1, 512);
  EXPECT_NEAR(c.set.sealed_m2, 6 * 0.3 * 0.3 + 2 * 0.05 * 0.1, 1e-6);
  EXPECT_NEAR(c.set.area_m2, 6 * 0.3 * 0.3 + 2 * 0.05 * 0.1, 1e-6);
  for (uint32_t i = 0; i < c.set.patches.size(); ++i) {
    EXPECT_EQ(c.rows.absorbed[i], 0u);
    EXPECT_EQ(c.rows.buried[i], 0u);
  }
}

TEST(Pool, RowsDoNotDependOnBucketsNorOnTheOrderOfRanges) {
  const CastScene c = room();
  const auto n = static_cast<uint32_t>(c.set.patches.size());
  const std::vector<float> areas = areasOf(c);
  const PooledPatches whole(c.rows, areas);
  std::vector<uint32_t> number(n);  // some other order of nodes
  for (uint32_t p = 0; p < n; ++p) number[p] = (p * 7 + 3) % n;
  ASSERT_NE(n % 7, 0u);
  std::vector<double> density(n);
  for (uint32_t p = 0; p < n; ++p) density[number[p]] = c.rows.rays[p] / static_cast<double>(areas[p]);
  // Ranges of 50 patches, the last ones first.
  Spill spill("/nowhere/spill", uint64_t{1} << 30);
  HitPool pool(number, areas, density, {0, 1, n / 3, n - 2, n}, spill);
  for (uint32_t first = (n - 1) / 50 * 50;; first -= 50) {
    HitRows part;
    const uint32_t end = std::min(n, first + 50);
    const auto range = [&](const auto& values) { return std::remove_cvref_t<decltype(values)>(values.begin() + first, values.begin() + end); };
    part.rays = range(c.rows.rays);
    part.sky = range(c.rows.sky);
    part.absorbed = range(c.rows.absorbed);
    part.buried = range(c.rows.buried);
    part.sky_fraction = range(c.rows.sky_fraction);
    part.sky_means = range(c.rows.sky_means);
    part.lamps = range(c.rows.lamps);
    part.start = {0};
    for (uint32_t p = first; p < end; ++p) {
      for (uint64_t k = c.rows.start[p]; k < c.rows.start[p + 1]; ++k) {
        part.column.push_back(c.rows.column[k]);
        part.count.push_back(c.rows.count[k]);
        part.estimate.push_back(c.rows.estimate[k]);
        part.whole.push_back(c.rows.whole[k]);
      }
      part.start.push_back(part.column.size());
    }
    pool.add(first, part);
    if (first == 0) break;
  }
  ExchangeRow row, same;
  PooledRows rows;
  for (size_t b = 0; b < pool.buckets(); ++b) {
    pool.take(b, rows);
    for (uint32_t i = rows.first(); i < rows.end(); ++i) {
      const auto p = static_cast<uint32_t>(std::find(number.begin(), number.end(), i) - number.begin());
      rows.row(i, row);
      whole.row(p, same);
      std::map<uint32_t, double> expected;
      for (size_t k = 0; k < same.column.size(); ++k) expected[number[same.column[k]]] = same.area_m2[k];
      ASSERT_EQ(row.column.size(), expected.size());
      EXPECT_TRUE(std::is_sorted(row.column.begin(), row.column.end()));
      for (size_t k = 0; k < row.column.size(); ++k) EXPECT_EQ(row.area_m2[k], expected.at(row.column[k]));
      EXPECT_EQ(row.sky_m2, same.sky_m2);
      EXPECT_EQ(row.absorbed_m2, same.absorbed_m2);
    }
  }
}

TEST(Pyramid, ExchangeAreasOfClustersAreTheSumsOverTheirPatches) {
  const CastScene c = cast(closedBox({.5f, .5f, .5f}, {}), 0.05f, 64);
  const std::vector<float> sky(c.set.patches.size(), 0);
  const Hierarchy h = makeHierarchy(c.set.patches, sky);
  ASSERT_GE(h.levels(), 2u);
  const PooledPatches pooled(c.rows, areasOf(c));
  std::vector<NodeRow> patches(pooled.nodes());  // by node
  for (uint32_t p = 0; p < pooled.nodes(); ++p) {
    NodeRow& row = patches[h.number[p]];
    row.node.area_m2 = c.set.patches[p].area_m2;
    row.direct.fill(static_cast<float>(p));
    ExchangeRow by_patch;
    pooled.row(p, by_patch);
    std::map<uint32_t, double> sorted;
    for (size_t k = 0; k < by_patch.column.size(); ++k) sorted[h.number[by_patch.column[k]]] = by_patch.area_m2[k];
    for (const auto& [j, area] : sorted) {
      row.row.column.push_back(j);
      row.row.area_m2.push_back(area);
    }
  }
  Spill spill("/nowhere/spill", uint64_t{1} << 30);
  LevelRows level0(h.tile_start[0].size() - 1, spill), level1(h.tile_start[1].size() - 1, spill);
  for (uint32_t t = 0; t + 1 < h.tile_start[0].size(); ++t)
    level0.put(t, std::span(patches).subspan(h.tile_start[0][t], h.tile_start[0][t + 1] - h.tile_start[0][t]));
  std::map<std::pair<uint32_t, uint32_t>, double> expected;
  std::vector<double> area(h.nodes[1]), direct(h.nodes[1]), reflected(h.nodes[1]);
  std::vector<LightValues> light(patches.size());
  for (uint32_t i = 0; i < patches.size(); ++i) {
    const uint32_t parent = h.parents[0][i];
    const auto own = static_cast<double>(patches[i].node.area_m2);
    light[i].fill(static_cast<float>(i));
    area[parent] += own;
    direct[parent] += own * static_cast<double>(patches[i].direct[0]);
    reflected[parent] += own * i;
    for (size_t k = 0; k < patches[i].row.column.size(); ++k) expected[{parent, h.parents[0][patches[i].row.column[k]]}] += patches[i].row.area_m2[k];
  }
  WorkCount done;
  const auto clusters_light = gatherClusters(level0, light, h, 1, level1, done);
  size_t entries = 0;
  double whole = 0;
  std::vector<NodeRow> rows;
  for (uint32_t t = 0; t + 1 < h.tile_start[1].size(); ++t) {
    level1.get(t, rows);
    for (uint32_t n = h.tile_start[1][t]; n < h.tile_start[1][t + 1]; ++n) {
      const NodeRow& row = rows[n - h.tile_start[1][t]];
      EXPECT_NEAR(static_cast<double>(row.node.area_m2), area[n], 1e-6 * area[n]);
      EXPECT_NEAR(static_cast<double>(row.direct[3]), direct[n] / area[n], 1e-5 * direct[n] / area[n]);
      EXPECT_NEAR(static_cast<double>(clusters_light[n][3]), reflected[n] / area[n], 1e-5 * reflected[n] / area[n]);
      whole += static_cast<double>(row.node.area_m2);
      entries += row.row.column.size();
      for (size_t k = 0; k < row.row.column.size(); ++k)  // stored as float
        EXPECT_NEAR(row.row.area_m2[k], expected.at({n, row.row.column[k]}), 1e-7 * expected.at({n, row.row.column[k]}));
    }
  }
  EXPECT_EQ(entries, expected.size());
  EXPECT_NEAR(whole, 6.0, 1e-4);
}

}  // namespace
}  // namespace ff::bake::test
