#include "runtime/cut/matrix_assembler.h"

#include <chrono>
#include <map>
#include <thread>

#include "runtime/cut/cut_builder.h"
#include "runtime/solver/solver.h"
#include "stream/start_threads.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

using NodeId = std::pair<uint32_t, uint64_t>;  // level, node

// What a matrix says of each node, by node instead of by slot.
struct NodeView {
  std::vector<std::pair<NodeId, uint32_t>> row;  // column and count, in order
  float scale = 0;
  bool leaf = false;
  NodeId parent{kNoSlot, 0};
  friend bool operator==(const NodeView&, const NodeView&) = default;
};

std::map<NodeId, NodeView> byNode(const LocalMatrix& m) {
  std::map<uint32_t, NodeId> node_of_slot;
  for (const SlotRange& range : m.tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const bool fresh =
          node_of_slot.emplace(range.first_slot + i, NodeId{range.id.level, range.first_node + i}).second;
      EXPECT_TRUE(fresh) << "two nodes in one slot";
    }
  std::map<NodeId, NodeView> nodes;
  for (const auto& [slot, id] : node_of_slot) {
    NodeView& view = nodes[id];
    for (const uint32_t entry : m.row(slot)) view.row.emplace_back(node_of_slot.at(slotOfEntry(entry)), countOfEntry(entry));
    view.scale = m.row_scale[slot];
    view.leaf = m.leaf[slot] != 0;
    if (m.parent_slot[slot] != kNoSlot) view.parent = node_of_slot.at(m.parent_slot[slot]);
  }
  return nodes;
}

void expectSame(const LocalMatrix& a, const LocalMatrix& b) {
  EXPECT_EQ(a.used_entries, b.used_entries);
  ASSERT_EQ(a.leaves.size(), b.leaves.size());
  ASSERT_EQ(a.refined.size(), b.refined.size());
  ASSERT_EQ(a.refined_level_start, b.refined_level_start);
  const auto x = byNode(a), y = byNode(b);
  ASSERT_EQ(x.size(), y.size());
  for (const auto& [id, view] : x) ASSERT_TRUE(view == y.at(id)) << id.first << ":" << id.second;
}

TEST(MatrixAssembler, AfterAnyWalkTheMatrixIsThatOfAFreshBuild) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    const TestWorld test({.side = 32, .tile_nodes = 24, .equal_areas = false, .seed = seed});
    MatrixAssembler walked(test.world());
    std::mt19937_64 random(seed);
    for (int step = 0; step < 40; ++step) {
      const double chance = static_cast<double>(random() % 11) / 10;
      const Cut cut = test.randomCut(chance, random(), step % 3 == 0);
      ASSERT_TRUE(walked.update(cut));
      MatrixAssembler fresh(test.world());
      ASSERT_TRUE(fresh.update(cut));
      expectSame(walked.matrix(), fresh.matrix());
    }
  }
}

// Slots are short: without fading tiles that may go, they are given out anew time and again.
TEST(MatrixAssembler, WhatFadesGoesBeforeSlotsAreGivenOutAnew) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 6});
  constexpr uint32_t kSlots = 640;
  MatrixAssembler assembler(test.world(), FarLight::kPyramid, kSlots), without(test.world(), FarLight::kPyramid, kSlots);
  const auto nodesOf = [](const Cut& cut) {
    size_t nodes = 0;
    for (const auto& strip : cut) nodes += strip->nodes.size();
    return nodes;
  };
  int renumbered = 0, renumbered_without = 0, gone = 0;
  Cut before;
  for (uint64_t step = 0; step < 150; ++step) {
    Cut active = test.randomCut(0.5, step);
    ASSERT_LT(nodesOf(active), kSlots);
    // What was there fades, parents first, as long as there are slots.
    std::set<formats::TileId> in;
    for (const auto& strip : active) in.insert(strip->id);
    Cut cut = active;
    std::vector<FadingTile> fading;
    for (size_t i = before.size(); i-- > 0;) {
      const auto& strip = before[i];
      if (in.contains(strip->id) || !in.contains({strip->id.level + 1, strip->tile.info().parent_tile})) continue;
      if (nodesOf(cut) + strip->nodes.size() > kSlots - 10) break;
      cut.push_back(strip);
      in.insert(strip->id);
      fading.push_back({strip->id, static_cast<float>(i % 3) / 3});
    }
    std::ranges::sort(cut, {}, [](const auto& strip) { return strip->id; });
    std::ranges::sort(fading, {}, &FadingTile::id);
    ASSERT_TRUE(assembler.update(cut, fading));
    ASSERT_TRUE(without.update(cut));
    renumbered += assembler.change().renumbered;
    renumbered_without += without.change().renumbered;
    std::set<formats::TileId> there;
    for (const SlotRange& range : assembler.matrix().tiles) there.insert(range.id);
    for (const auto& strip : active) ASSERT_TRUE(there.contains(strip->id));
    gone += static_cast<int>(cut.size() - there.size());
    Cut now;
    for (const auto& strip : cut)
      if (there.contains(strip->id)) now.push_back(strip);
    ASSERT_EQ(now.size(), there.size());
    MatrixAssembler fresh(test.world());
    ASSERT_TRUE(fresh.update(now));
    expectSame(assembler.matrix(), fresh.matrix());
    ASSERT_TRUE(assembler.update(cut, fading));
    ASSERT_FALSE(assembler.change().any) << "what is gone does not come back";
    before = now;
  }
  EXPECT_GT(renumbered_without, 5);
  EXPECT_LT(renumbered, renumbered_without / 4);
  EXPECT_GT(gone, 5);
}

TEST(MatrixAssembler, ASlotKeepsItsNodeWhileItsTileIsActive) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 4});
  MatrixAssembler assembler(test.world());
  std::map<formats::TileId, uint32_t> first_slot;
  for (uint64_t step = 0; step < 60; ++step) {
    ASSERT_TRUE(assembler.update(test.randomCut(0.7, step, step % 3 == 0)));
    const MatrixChange& change = assembler.change();
    if (change.renumbered) first_slot.clear();
    for (const SlotRange& left : change.left) EXPECT_EQ(first_slot.erase(left.id), change.renumbered ? 0u : 1u);
    for (const uint32_t t : change.entered) {
      const SlotRange& range = assembler.matrix().tiles[t];
      EXPECT_TRUE(first_slot.emplace(range.id, range.first_slot).second);
    }
    ASSERT_EQ(first_slot.size(), assembler.matrix().tiles.size());
    for (const SlotRange& range : assembler.matrix().tiles) EXPECT_EQ(first_slot.at(range.id), range.first_slot);
  }
}

TEST(MatrixAssembler, NamesEveryTileWhoseRowsChanged) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 5});
  MatrixAssembler assembler(test.world());
  std::map<formats::TileId, std::vector<std::vector<uint32_t>>> rows;  // as last named
  const auto rowsOf = [&](const SlotRange& range) {
    std::vector<std::vector<uint32_t>> all;
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const auto row = assembler.matrix().row(range.first_slot + i);
      all.emplace_back(row.begin(), row.end());
      // A slot that is no longer a leaf loses its row without its tile being named: MatrixChange::entered tells.
      if (!assembler.matrix().leaf[range.first_slot + i]) all.back().assign(1, kNoSlot);
    }
    return all;
  };
  int unnamed = 0;
  for (uint64_t step = 0; step < 60; ++step) {
    ASSERT_TRUE(assembler.update(test.randomCut(0.8, step / 2 * 2 + step % 2, step % 5 == 0)));
    const LocalMatrix& m = assembler.matrix();
    for (const uint32_t t : assembler.change().rows) rows[m.tiles[t].id] = rowsOf(m.tiles[t]);
    for (const SlotRange& range : m.tiles) {
      auto now = rowsOf(range);
      const auto& known = rows.at(range.id);
      for (size_t i = 0; i < now.size(); ++i) {
        const bool refined = now[i] == std::vector<uint32_t>{kNoSlot};
        if (!refined) {
          ASSERT_EQ(now[i], known[i]) << step;
        }
      }
    }
    unnamed += static_cast<int>(m.tiles.size() - assembler.change().rows.size());
  }
  EXPECT_GT(unnamed, 0);  // else the list says nothing
}

TEST(MatrixAssembler, TheSameCutAgainChangesNothing) {
  const TestWorld test({.side = 16, .tile_nodes = 12});
  MatrixAssembler assembler(test.world());
  const Cut cut = test.randomCut(0.6, 1);
  ASSERT_TRUE(assembler.update(cut));
  EXPECT_TRUE(assembler.change().any);
  ASSERT_TRUE(assembler.update(cut));
  EXPECT_FALSE(assembler.change().any);
  EXPECT_TRUE(assembler.change().rows.empty());
}

TEST(MatrixAssembler, ARefusedCutLeavesTheMatrixAsItWas) {
  const TestWorld test({.side = 16, .tile_nodes = 12});
  MatrixAssembler assembler(test.world());
  const Cut cut = test.randomCut(0.6, 1);
  ASSERT_TRUE(assembler.update(cut));
  Cut broken = test.randomCut(0.9, 2);
  broken.pop_back();  // a tile of the top level
  const auto refused = assembler.update(broken);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUsage);
  MatrixAssembler fresh(test.world());
  ASSERT_TRUE(fresh.update(cut));
  expectSame(assembler.matrix(), fresh.matrix());
}

// The bits of a node's radiosity depend on its row's order and on the light alone, not on the numbers of slots.
TEST(MatrixAssembler, RadiosityHasTheSameBitsWhateverTheWalk) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 6});
  const Cut cut = test.randomCut(0.6, 77);
  MatrixAssembler walked(test.world()), fresh(test.world());
  for (uint64_t step = 0; step < 10; ++step) ASSERT_TRUE(walked.update(test.randomCut(0.7, step)));
  std::map<NodeId, Vec4> radiosity[2];
  int which = 0;
  for (MatrixAssembler* assembler : {&walked, &fresh}) {
    ASSERT_TRUE(assembler->update(cut));
    const LocalMatrix& m = assembler->matrix();
    std::vector<Vec4> source(m.slots()), out(m.slots());
    for (const SlotRange& range : m.tiles)
      for (uint32_t i = 0; i < range.nodes; ++i)
        source[range.first_slot + i] = {static_cast<float>((range.first_node + i) % 13), 1, 0.25f, 0};
    const auto solver = makeCpuGather(2);
    ASSERT_TRUE(solver->update(m, {.any = true, .renumbered = true}));
    ASSERT_TRUE(solver->setSource(source));
    ASSERT_TRUE(solver->iterate(20));
    ASSERT_TRUE(solver->radiosity(out));
    for (const SlotRange& range : m.tiles)
      for (uint32_t i = 0; i < range.nodes; ++i)
        radiosity[which][{range.id.level, range.first_node + i}] = out[range.first_slot + i];
    ++which;
  }
  ASSERT_EQ(radiosity[0].size(), radiosity[1].size());
  for (const auto& [id, b] : radiosity[0]) {
    ASSERT_EQ(b.x, radiosity[1].at(id).x);
    ASSERT_EQ(b.y, radiosity[1].at(id).y);
  }
}

stream::StripList listOf(const Cut& cut) { return std::make_shared<const Cut>(cut); }

// However often somebody looks in the meantime: matrix, slots and changes, and what is written of these for a device, are those of one assembler that takes up the same cuts.
TEST(CutBuilder, GivesInTheBackgroundWhatAnAssemblerGives) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 7});
  CutBuilder builder(test.world(), FarLight::kPyramid, true, nullptr, true);
  MatrixAssembler reference(test.world());
  const LocalMatrix* const where = &builder.matrix();
  std::mt19937_64 random(8);
  int taken = 0;
  for (int step = 0; step < 60; ++step) {
    const Cut asked = test.randomCut(static_cast<double>(random() % 11) / 10, random(), step % 4 == 0);
    if (step % 7 == 6) {
      builder.renumberNext();
      reference.renumberNext();
    }
    const int more = static_cast<int>(random() % 3);
    ASSERT_TRUE(builder.ask({listOf(asked)}));
    builder.begin();
    for (int k = 0; k < more; ++k) {  // looks again before, or after, it is there
      if (random() % 2) builder.await();
      ASSERT_TRUE(builder.take());
      ASSERT_TRUE(builder.ask({listOf(asked)}));
    }
    builder.await();
    ASSERT_TRUE(builder.take());
    ASSERT_TRUE(builder.holds(asked));
    ASSERT_TRUE(reference.update(asked));
    const LocalMatrix &m = builder.matrix(), &n = reference.matrix();
    ASSERT_EQ(&m, where);
    ASSERT_EQ(m.tiles.size(), n.tiles.size());
    for (size_t t = 0; t < m.tiles.size(); ++t) {
      ASSERT_EQ(m.tiles[t].id, n.tiles[t].id);
      ASSERT_EQ(m.tiles[t].first_slot, n.tiles[t].first_slot);
      ASSERT_EQ(&builder.strip(t), &reference.strip(t));
    }
    ASSERT_EQ(m.leaves, n.leaves);
    ASSERT_EQ(m.child_weight, n.child_weight);
    ASSERT_EQ(m.leaf_parts, n.leaf_parts);
    ASSERT_EQ(m.leaf_parts.back(), m.leaves.size());
    for (const uint32_t slot : m.leaves) ASSERT_TRUE(std::ranges::equal(m.row(slot), n.row(slot)));
    if (more == 0) {  // else it was told by a call before
      ++taken;
      ASSERT_EQ(builder.change().entered, reference.change().entered);
      ASSERT_EQ(builder.change().rows, reference.change().rows);
      ASSERT_EQ(builder.change().renumbered, reference.change().renumbered);
      ASSERT_EQ(builder.change().left.size(), reference.change().left.size());
      ASSERT_TRUE(builder.change().packed);
      for (size_t k = 0; k < reference.change().entered.size(); ++k) {
        const uint32_t t = reference.change().entered[k];
        const LocalMatrix::PackedRows& rows = n.packed[t];
        std::vector<uint32_t> words(packedShape(*rows.strip, rows.partner_pages.size()).words);
        writePacked(n, n.tiles[t], n.places[t].bounds, *rows.strip, rows.partner_pages, words.data());
        ASSERT_TRUE(std::ranges::equal(builder.change().packed->tile(k), words));
      }
      ASSERT_EQ(builder.change().pages, reference.change().pages);
      const auto pages = builder.change().packed->pages();
      ASSERT_EQ(pages.size(), reference.change().pages.size());
      for (size_t p = 0; p < pages.size(); ++p) ASSERT_EQ(pages[p], n.pages->page(reference.change().pages[p]));
    }
  }
  EXPECT_GT(taken, 10);
  EXPECT_GT(builder.latencySeconds(), 0);
}

// Whether its thread looks or sleeps: nobody waits for it.
TEST(CutBuilder, FindsOutByItselfThatItIsAsked) {
  const TestWorld test({.side = 16, .tile_nodes = 12});
  CutBuilder builder(test.world(), FarLight::kPyramid, true);
  for (const uint64_t seed : {1, 2, 3}) {
    const Cut asked = test.randomCut(0.6, seed);
    ASSERT_TRUE(builder.ask({listOf(asked)}));
    builder.begin();
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (!builder.holds(asked) && std::chrono::steady_clock::now() < until) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      ASSERT_TRUE(builder.take());
    }
    ASSERT_TRUE(builder.holds(asked));
    if (seed == 2) std::this_thread::sleep_for(2 * stream::kLooks * stream::kLook);
  }
}

TEST(CutBuilder, ARefusedCutLeavesTheMatrixAsItWasAndTheNextOneComes) {
  const TestWorld test({.side = 16, .tile_nodes = 12});
  CutBuilder builder(test.world(), FarLight::kPyramid, true);
  const Cut cut = test.randomCut(0.6, 1), after = test.randomCut(0.9, 3);
  Cut broken = test.randomCut(0.9, 2);
  broken.pop_back();  // a tile of the top level
  const auto follow = [&](const Cut& next) {
    EXPECT_TRUE(builder.ask({listOf(next)}));
    builder.await();
    return builder.take();
  };
  ASSERT_TRUE(follow(cut));
  const auto refused = follow(broken);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUsage);
  EXPECT_FALSE(builder.change().any);
  MatrixAssembler fresh(test.world());
  ASSERT_TRUE(fresh.update(cut));
  expectSame(builder.matrix(), fresh.matrix());
  ASSERT_TRUE(follow(after));
  MatrixAssembler same(test.world());
  ASSERT_TRUE(same.update(after));
  expectSame(builder.matrix(), same.matrix());
}

}  // namespace
}  // namespace ff::runtime
