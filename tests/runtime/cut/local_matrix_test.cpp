#include <map>

#include "runtime/cut/page_table.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

using formats::TileId;

// The slot that stands for a node, by the definition alone.
uint32_t resolveByWalking(const TestWorld& test, const LocalMatrix& matrix, uint32_t level, uint64_t node) {
  for (;;) {
    for (const SlotRange& range : matrix.tiles)
      if (range.id.level == level && node >= range.first_node && node < range.first_node + range.nodes)
        return range.first_slot + static_cast<uint32_t>(node - range.first_node);
    node = test.world().parent(level, node);
    ++level;
  }
}

LocalMatrix build(const TestWorld& test, const Cut& cut, FarLight far_light = FarLight::kPyramid) {
  auto built = buildLocalMatrix(test.world(), cut, far_light);
  EXPECT_TRUE(built) << built.error().line();
  return std::move(*built);
}

TEST(PageTable, ResolvesEveryNodeOfEveryTileAsAWalkUpTheParentsDoes) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 3});
  for (uint64_t seed = 1; seed <= 4; ++seed) {
    const LocalMatrix matrix = build(test, test.randomCut(0.6, seed, seed % 2 == 0));
    PageTable pages(test.world());
    for (const SlotRange& range : matrix.tiles) pages.setActive(range.id, range.first_slot);
    for (uint32_t level = 0; level < test.world().levels().size(); ++level)
      for (const formats::TileInfo& info : test.world().tiles(level)) {
        const uint32_t number = pages.hold(*test.world().ref(info.id).chunk, info.id.tile);
        pages.refresh();
        for (uint32_t i = 0; i < info.nodes; ++i)
          ASSERT_EQ(pages.page(number).slot(i), resolveByWalking(test, matrix, level, info.first_node + i))
              << level << ":" << info.first_node + i;
      }
    EXPECT_FALSE(pages.incomplete());
  }
}

TEST(LocalMatrix, RowsAreTheStripsRowsWithColumnsResolvedAndMerged) {
  for (uint64_t seed = 1; seed <= 4; ++seed) {
    const TestWorld test({.side = 16, .tile_nodes = 12, .equal_areas = false, .seed = seed});
    for (const double chance : {0.0, 0.3, 0.7, 1.0}) {
      const Cut cut = test.randomCut(chance, seed + 100, seed % 2 == 0);
      const LocalMatrix matrix = build(test, cut);
      uint64_t twice = 0;
      uint32_t slot = 0;
      for (const auto& active : cut) {
        const formats::Strip* const strip = &test.strip(active->id);
        std::vector<std::map<uint32_t, uint32_t>> expected(strip->nodes.size());
        size_t k = 0;
        for (const formats::Block& block : strip->blocks)
          for (const size_t end = k + block.entries; k < end; ++k) {
            const uint64_t column =
                test.world().tiles(strip->id.level)[block.partner_tile].first_node + strip->columns[k];
            expected[strip->rows[k]][resolveByWalking(test, matrix, strip->id.level, column)] += strip->counts[k];
          }
        for (size_t i = 0; i < strip->nodes.size(); ++i, ++slot) {
          std::map<uint32_t, uint32_t> row;
          uint32_t before = kNoSlot;
          for (const uint32_t entry : matrix.row(slot)) {
            row[slotOfEntry(entry)] += countOfEntry(entry);
            // Neighbours that resolve to one slot are merged within a run; over runs they may meet.
            twice += slotOfEntry(entry) == before;
            before = slotOfEntry(entry);
          }
          if (!matrix.leaf[slot]) expected[i].clear();
          ASSERT_EQ(row, expected[i]) << "slot " << slot;
          ASSERT_EQ(matrix.row_scale[slot], 1.0f / static_cast<float>(strip->nodes[i].quanta));
          ASSERT_EQ(matrix.area_m2[slot], strip->nodes[i].area_m2);
        }
      }
      ASSERT_EQ(slot, matrix.slots());
      EXPECT_LT(twice, matrix.used_entries / 2);
    }
  }
}

TEST(LocalMatrix, ANodeIsRefinedExactlyWhenItsChildrenAreActive) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 9});
  for (const bool orphans : {false, true}) {
    const Cut cut = test.randomCut(0.6, 5, orphans);
    const LocalMatrix matrix = build(test, cut);
    std::map<uint32_t, std::vector<uint32_t>> refined;  // children of each
    for (size_t l = 0; l + 1 < matrix.refined_level_start.size(); ++l)
      for (uint32_t r = matrix.refined_level_start[l]; r < matrix.refined_level_start[l + 1]; ++r) {
        const LocalMatrix::Refined& item = matrix.refined[r];
        std::vector<uint32_t> children;
        // They come from an earlier range, or are leaves.
        matrix.forEachChild(item, [&](uint32_t c) {
          ASSERT_TRUE(matrix.leaf[c] || refined.count(c) != 0);
          children.push_back(c);
        });
        ASSERT_TRUE(refined.emplace(item.slot, children).second);
      }
    for (const SlotRange& range : matrix.tiles)
      for (uint32_t i = 0; i < range.nodes; ++i) {
        const uint32_t slot = range.first_slot + i;
        const uint64_t node = range.first_node + i;
        bool children_active = false;
        if (range.id.level > 0) {
          std::vector<uint32_t> children;
          for (const uint32_t child : test.world().children(range.id.level, node)) children.push_back(matrix.slotOf(range.id.level - 1, child));
          children_active = children[0] != kNoSlot;
          if (children_active) {
            ASSERT_EQ(refined.at(slot), children);
          }
        }
        ASSERT_EQ(matrix.leaf[slot] == 0, children_active);
        ASSERT_EQ(refined.count(slot), children_active ? 1u : 0u);
        ASSERT_EQ(matrix.slotOf(range.id.level, node), slot);
      }
  }
}

TEST(LocalMatrix, IsAFunctionOfTheCutAlone) {
  const TestWorld test({.side = 16, .tile_nodes = 12});
  const Cut cut = test.randomCut(0.5, 1);
  const LocalMatrix a = build(test, cut);
  (void)build(test, test.randomCut(0.9, 2));
  const LocalMatrix b = build(test, cut);
  EXPECT_EQ(a.entries, b.entries);
  EXPECT_EQ(a.row_start, b.row_start);
}

TEST(LocalMatrix, ConstantFarLightSendsAllOtherColumnsToOneSlot) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 4});
  const Cut cut = test.randomCut(0.95, 8);
  const LocalMatrix matrix = build(test, cut, FarLight::kConstant);
  ASSERT_GT(matrix.tiles.size(), 2u);
  ASSERT_LT(matrix.tiles.size(), test.world().tiles(0).size());
  const uint32_t ambient = matrix.ambient_slot;
  ASSERT_LT(ambient, matrix.slots());
  EXPECT_TRUE(matrix.row(ambient).empty());
  uint32_t slots = 1;
  bool met = false;
  for (const auto& strip : cut) {
    if (strip->id.level != 0) continue;
    for (uint32_t i = 0; i < strip->nodes.size(); ++i) {
      const formats::Node& node = strip->nodes[i];
      uint32_t sum = 0;
      for (const uint32_t entry : matrix.row(matrix.slotOf(0, strip->first_node + i))) {
        ASSERT_LT(slotOfEntry(entry), matrix.slots());
        met = met || slotOfEntry(entry) == ambient;
        sum += countOfEntry(entry);
      }
      ASSERT_EQ(sum + node.sky + node.absorbed, node.quanta);
      ++slots;
    }
  }
  EXPECT_EQ(slots, matrix.slots());
  EXPECT_TRUE(met);
}

TEST(LocalMatrix, RefusesACutWithoutAllOfTheTopLevel) {
  const TestWorld test({.side = 16, .tile_nodes = 12});
  Cut cut = test.randomCut(1, 1);
  cut.pop_back();  // a tile of the top level
  const auto built = buildLocalMatrix(test.world(), cut);
  ASSERT_FALSE(built);
  EXPECT_EQ(built.error().code, ErrorCode::kUsage);
}

TEST(LocalMatrix, RefusesMoreNodesThanSlots) {
  const TestWorld test({.side = 16, .levels = 2, .tile_nodes = 200});
  Cut cut;
  const Cut all = test.randomCut(1, 1);
  while (cut.size() * 100 < kMaxSlots + 20000) cut.push_back(all.front());  // the check comes before any other look
  const auto built = buildLocalMatrix(test.world(), cut);
  ASSERT_FALSE(built);
  EXPECT_EQ(built.error().code, ErrorCode::kUsage);
}

}  // namespace
}  // namespace ff::runtime
