#include "runtime/solver/solver.h"

#include <cmath>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/cut/node_values.h"
#include "runtime/full_solve.h"
#include "runtime/gather/gather_kernels.h"
#include "runtime/solver/fallback_solver.h"
#include "runtime/solver/worker_pool.h"
#include "tests/runtime/solver/bad_numbers.h"
#include "tests/runtime/solver/solver_truth.h"
#include "tests/runtime/test_world.h"
#include "tests/support/hand_made.h"

namespace ff::runtime {
namespace {

std::shared_ptr<const LocalMatrix> solverMatrix(const TestWorld& test, const Cut& cut) {
  auto built = buildLocalMatrix(test.world(), cut);
  EXPECT_TRUE(built) << built.error().line();
  return std::make_shared<const LocalMatrix>(std::move(*built));
}

std::vector<Vec4> randomSource(uint32_t slots, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<Vec4> source(slots);
  const auto next = [&] { return static_cast<float>(random() >> 40) / 16777216.0f; };
  for (Vec4& s : source) s = {next(), 10 * next(), next() < 0.5f ? 0.0f : next(), 0};
  return source;
}

std::vector<Vec4> solve(Solver& solver, const std::shared_ptr<const LocalMatrix>& matrix, std::span<const Vec4> source,
                        int iterations) {
  EXPECT_TRUE(setMatrix(solver, *matrix));
  EXPECT_TRUE(solver.setSource(source));
  EXPECT_TRUE(solver.iterate(iterations));
  std::vector<Vec4> out(matrix->slots());
  EXPECT_TRUE(solver.radiosity(out));
  return out;
}

// k Jacobi iterations from zero in double precision: every node's row straight from its strip, columns resolved by
// walking up the parents. O(entries) per iteration without any of the structures under test.
std::vector<std::array<double, 3>> naive(const TestWorld& test, const Cut& cut, std::span<const Vec4> source, int k) {
  std::map<std::pair<uint32_t, uint64_t>, uint32_t> slot_of;  // (level, node)
  uint32_t slots = 0;
  for (const auto& strip : cut)
    for (uint32_t i = 0; i < strip->nodes.size(); ++i) slot_of[{strip->id.level, strip->first_node + i}] = slots++;
  std::vector<std::array<double, 3>> from(slots), to(slots);
  for (int iteration = 0; iteration < k; ++iteration) {
    for (const auto& strip : cut) {  // finest level first: refined nodes find their children done
      const uint32_t level = strip->id.level;
      std::vector<std::array<double, 3>> irradiance(strip->nodes.size());
      const formats::Strip& rows = test.strip(strip->id);
      size_t e = 0;
      for (const formats::Block& block : rows.blocks)
        for (const size_t end = e + block.entries; e < end; ++e) {
          uint32_t l = level;
          uint64_t node = test.world().tiles(level)[block.partner_tile].first_node + rows.columns[e];
          while (slot_of.count({l, node}) == 0) node = test.world().parent(l++, node);
          const std::array<double, 3>& b = from[slot_of[{l, node}]];
          for (size_t c = 0; c < 3; ++c)
            irradiance[rows.rows[e]][c] += b[c] * rows.counts[e] / rows.nodes[rows.rows[e]].quanta;
        }
      for (uint32_t i = 0; i < strip->nodes.size(); ++i) {
        const uint64_t node = strip->first_node + i;
        const uint32_t slot = slot_of[{level, node}];
        const auto children = level > 0 ? test.world().children(level, node) : std::span<const uint32_t>();
        if (level > 0 && slot_of.count({level - 1, children[0]}) != 0) {
          std::array<double, 3> sum{};
          double area = 0;
          for (const uint32_t child : children) {
            const double a = static_cast<double>(test.node(level - 1, child).area_m2);
            area += a;
            for (size_t c = 0; c < 3; ++c) sum[c] += a * to[slot_of[{level - 1, child}]][c];
          }
          for (size_t c = 0; c < 3; ++c) to[slot][c] = sum[c] / area;
        } else {
          const float m[3] = {source[slot].x, source[slot].y, source[slot].z};
          for (size_t c = 0; c < 3; ++c)
            to[slot][c] = static_cast<double>(m[c]) +
                          static_cast<double>(strip->nodes[i].albedo[static_cast<int>(c)]) * irradiance[i][c];
        }
      }
    }
    from.swap(to);
  }
  return from;
}

// fp32 rounding. A sum of n products of non-negative terms errs by at most about n * 2^-24 of itself; rows here have at
// most 150 entries, and the error of the radiosities that enter is damped by albedo <= 0.9 in each iteration, so that
// it adds up to at most 1 / (1 - 0.9) times one iteration's: 150 * 2^-24 * 10 < 1e-4. Random signs make it far smaller.
constexpr double kRoundingTolerance = 1e-4;

void expectNear(std::span<const Vec4> got, std::span<const std::array<double, 3>> expected, double tolerance) {
  double largest = 0, difference = 0;
  for (size_t s = 0; s < got.size(); ++s) {
    const float b[3] = {got[s].x, got[s].y, got[s].z};
    for (size_t c = 0; c < 3; ++c) {
      largest = std::max(largest, expected[s][c]);
      difference = std::max(difference, std::abs(static_cast<double>(b[c]) - expected[s][c]));
    }
  }
  EXPECT_GT(largest, 0);
  EXPECT_LE(difference, tolerance * largest);
}

TEST(CpuGather, AgreesWithANaiveDoublePrecisionReferenceOnRandomCuts) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    const TestWorld test({.side = 16, .tile_nodes = 12, .equal_areas = false, .seed = seed});
    for (const double chance : {0.0, 0.4, 0.8, 1.0}) {
      const Cut cut = test.randomCut(chance, seed, seed % 2 == 0);
      const auto matrix = solverMatrix(test, cut);
      const std::vector<Vec4> source = randomSource(matrix->slots(), seed);
      for (const int k : {1, 2, 7}) {
        const auto solver = makeCpuGather(2);
        expectNear(solve(*solver, matrix, source, k), naive(test, cut, source, k), kRoundingTolerance);
      }
    }
  }
}

TEST(CpuGather, GivesTheSameBitsForEveryNumberOfThreads) {
  const TestWorld test({.side = 64, .tile_nodes = 200, .quanta = 200, .seed = 5});
  const auto matrix = solverMatrix(test, test.randomCut(1, 2));
  ASSERT_GT(matrix->entries.size(), 5u * 16384u) << "too small to be divided";
  const std::vector<Vec4> source = randomSource(matrix->slots(), 1);
  const std::vector<Vec4> one = solve(*makeCpuGather(1), matrix, source, 9);
  for (const int threads : {2, 3, 4, 7}) {
    const std::vector<Vec4> many = solve(*makeCpuGather(threads), matrix, source, 9);
    for (size_t s = 0; s < one.size(); ++s) {
      ASSERT_EQ(one[s].x, many[s].x);
      ASSERT_EQ(one[s].y, many[s].y);
      ASSERT_EQ(one[s].z, many[s].z);
    }
  }
}

TEST(CpuGather, WhatEntersStartsFromTheSameLightWheneverThatIsAskedFor) {
  for (const uint32_t frames : {0u, 8u}) {
    const TestWorld test({.side = 32, .tile_nodes = 32, .seed = 8});
    MatrixAssembler assembler(test.world());
    const auto asked = makeCpuGather(1), late = makeCpuGather(3);
    for (uint64_t change = 0; change < 24; ++change) {
      SCOPED_TRACE(change);
      ASSERT_TRUE(assembler.update(test.randomCut(change % 5 == 4 ? 1.0 : 0.5, change, change % 3 == 1)));
      const LocalMatrix& m = assembler.matrix();
      const std::vector<Vec4> source = randomSource(m.slots(), change);
      std::vector<Vec4> a(m.slots()), b(m.slots());
      for (Solver* solver : {asked.get(), late.get()}) {
        solver->ease(frames);
        ASSERT_TRUE(solver->update(m, assembler.change()));
        ASSERT_TRUE(solver->setSource(source));
      }
      ASSERT_TRUE(asked->radiosity(a));
      if (change % 3 != 2) continue;  // so that more enters, and some leaves again, before there is a step
      for (Solver* solver : {asked.get(), late.get()}) ASSERT_TRUE(solver->iterate(1));
      ASSERT_TRUE(asked->radiosity(a) && late->radiosity(b));
      for (size_t s = 0; s < a.size(); ++s) ASSERT_TRUE(a[s].x == b[s].x && a[s].y == b[s].y && a[s].z == b[s].z) << "slot " << s;
    }
  }
}

TEST(CpuGather, VectorAndPortableKernelsAgree) {
  const GatherKernel fast = gatherAvx2();
  if (!fast) GTEST_SKIP() << "no AVX2 on this machine: the portable kernel is the only one";
  const TestWorld test({.side = 32, .tile_nodes = 60, .seed = 5});
  const auto matrix = solverMatrix(test, test.randomCut(0.8, 2));
  const std::vector<Vec4> source = randomSource(matrix->slots(), 1), from = randomSource(matrix->slots(), 2);
  std::vector<Vec4> a(matrix->slots()), b(matrix->slots());
  GatherJob job{matrix->row_start.data(),
                matrix->row_entries.data(),
                matrix->entries.data(),
                matrix->leaves.data(),
                matrix->albedo.data(),
                matrix->row_scale.data(),
                source.data(),
                from.data(),
                a.data()};
  const auto count = static_cast<uint32_t>(matrix->leaves.size());
  EXPECT_TRUE(gatherPortable(job, 0, count));
  job.to = b.data();
  EXPECT_TRUE(fast(job, 0, count));
  for (size_t s = 0; s < a.size(); ++s) {
    // Another order of at most 150 additions of non-negative terms: 150 * 2^-24 < 1e-5 of the sum.
    ASSERT_NEAR(a[s].x, b[s].x, 1e-5f * a[s].x);
    ASSERT_NEAR(a[s].y, b[s].y, 1e-5f * a[s].y);
    ASSERT_NEAR(a[s].z, b[s].z, 1e-5f * a[s].z);
  }
  for (const float bad : kBadNumbers)
    for (const uint32_t leaf : {0u, count / 2, count - 1})
      for (float Vec4::*channel : {&Vec4::x, &Vec4::y, &Vec4::z}) {
        std::vector<Vec4> broken = source;
        broken[matrix->leaves[leaf]].*channel = bad;
        job.source = broken.data();
        EXPECT_FALSE(gatherPortable(job, 0, count)) << bad;
        EXPECT_FALSE(fast(job, 0, count)) << bad;
      }
}

TEST(CpuGather, AClosedBoxOfUniformLightHasTheFurnaceRadiosityOnEveryCut) {
  // B = M / (1 - rho) everywhere, whatever the form factors, since every row sums to one exactly.
  for (const float rho : {0.5f, 0.9f}) {
    const TestWorld test({.side = 16, .tile_nodes = 12, .sky_share = 0, .albedo = rho, .seed = 2});
    for (const double chance : {0.0, 0.5, 1.0}) {
      const auto matrix = solverMatrix(test, test.randomCut(chance, 3));
      const std::vector<Vec4> source(matrix->slots(), Vec4{1, 2, 3, 0});
      // rho^400 < 1e-18: converged. Left is fp32 rounding (kRoundingTolerance).
      const std::vector<Vec4> b = solve(*makeCpuGather(2), matrix, source, 400);
      for (uint32_t s = 0; s < matrix->slots(); ++s) {
        // The stored albedo is rho in 16 bits fixed point; the cluster's own mean of it may round differently.
        const double expected = 1 / (1 - static_cast<double>(matrix->albedo[s].x));
        ASSERT_NEAR(static_cast<double>(matrix->albedo[s].x), static_cast<double>(rho), 1.0 / 65535);
        const double tolerance = (kRoundingTolerance + 2.0 / 65535 * expected) * expected;
        ASSERT_NEAR(static_cast<double>(b[s].x), expected, tolerance);
        ASSERT_NEAR(static_cast<double>(b[s].y), 2 * expected, 2 * tolerance);
        ASSERT_NEAR(static_cast<double>(b[s].z), 3 * expected, 3 * tolerance);
      }
    }
  }
}

// Jacobi needs ln(1e4) / (1 - rho) steps to shrink the error 1e4-fold, 460 at 0.98; the semi-iteration about ln(2e4) /
// sqrt(2 (1 - rho)), 50, and as many again to learn how slowly light decays and to start anew with each call.
TEST(CpuGather, ApproachSettlesAClosedBoxInAFourthOfTheSteps) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .sky_share = 0, .albedo = 0.98f, .seed = 2});
  const auto matrix = solverMatrix(test, test.randomCut(0.5, 3));
  const std::vector<Vec4> source = randomSource(matrix->slots(), 4);
  const std::vector<Vec4> settled = solve(*makeCpuGather(2), matrix, source, 3000);
  const auto error = [&](std::span<const Vec4> b) {
    double difference = 0, norm = 0;
    for (const uint32_t s : matrix->leaves) {
      const auto exact = static_cast<double>(settled[s].y);
      difference += (static_cast<double>(b[s].y) - exact) * (static_cast<double>(b[s].y) - exact);
      norm += exact * exact;
    }
    return std::sqrt(difference / norm);
  };
  const auto solver = makeCpuGather(2);
  std::vector<Vec4> b = solve(*solver, matrix, source, 0);
  double before = 1;
  for (int calls = 0; calls < 4; ++calls) {
    ASSERT_TRUE(solver->approach(28));
    ASSERT_TRUE(solver->radiosity(b));
    ASSERT_LT(error(b), before) << "call " << calls;
    before = error(b);
    for (const uint32_t s : matrix->leaves) ASSERT_GE(b[s].y, source[s].y);
  }
  EXPECT_LT(before, 1e-4);
  EXPECT_GT(error(solve(*makeCpuGather(2), matrix, source, 4 * 28)), 1e-2) << "where as many of Jacobi's steps leave it";
}

// 1000 times the light: Jacobi would need 10,000 steps.
TEST(CpuGather, ApproachSettlesAFurnaceThatKeepsAllButAThousandth) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .sky_share = 0, .albedo = 0.999f, .seed = 2});
  const auto matrix = solverMatrix(test, test.randomCut(0.5, 3));
  const auto solver = makeCpuGather(2);
  std::vector<Vec4> b = solve(*solver, matrix, std::vector<Vec4>(matrix->slots(), Vec4{1, 2, 3, 0}), 0);
  for (int calls = 0; calls < 8; ++calls) {
    ASSERT_TRUE(solver->approach(63));
    ASSERT_TRUE(solver->radiosity(b));
    for (const uint32_t s : matrix->leaves) {
      // Rounding of a step, 150 additions, is multiplied like light (kRoundingTolerance), and so is that of the albedo.
      const double full = 1 / (1 - static_cast<double>(matrix->albedo[s].x));
      ASSERT_LE(static_cast<double>(b[s].x), full * 1.05) << "call " << calls << ": never more than the furnace allows";
    }
  }
  for (const uint32_t s : matrix->leaves) {
    const double full = 1 / (1 - static_cast<double>(matrix->albedo[s].x));
    ASSERT_NEAR(static_cast<double>(b[s].x), full, 0.05 * full);
    ASSERT_NEAR(static_cast<double>(b[s].z), 3 * full, 0.15 * full);
  }
}

// Cuts of several levels, rows sampled apart: no reciprocity but on average. Light that decays fast is left to Jacobi.
TEST(CpuGather, ApproachEndsWhereIterationsEndOnAnyCutAndAlbedo) {
  for (const float rho : {0.2f, 0.7f, 0.95f})
    for (const double chance : {0.0, 0.4, 1.0}) {
      const TestWorld test({.side = 16, .tile_nodes = 12, .albedo = rho, .seed = 5});
      const auto matrix = solverMatrix(test, test.randomCut(chance, 6));
      const std::vector<Vec4> source = randomSource(matrix->slots(), 7);
      const std::vector<Vec4> settled = solve(*makeCpuGather(2), matrix, source, 600);
      const auto solver = makeCpuGather(2);
      std::vector<Vec4> b = solve(*solver, matrix, source, 1);
      for (int calls = 0; calls < 20; ++calls) ASSERT_TRUE(solver->approach(15));
      ASSERT_TRUE(solver->iterate(1));
      ASSERT_TRUE(solver->radiosity(b));
      for (const uint32_t s : matrix->leaves) {
        ASSERT_NEAR(b[s].x, settled[s].x, 2e-5f * settled[s].x) << "albedo " << rho << ", chance " << chance;
        ASSERT_NEAR(b[s].y, settled[s].y, 2e-5f * settled[s].y) << "albedo " << rho << ", chance " << chance;
      }
    }
}

// Its steps take turns with three lists of light; no step writes what tiles that left had in them.
TEST(CpuGather, ApproachLeavesFreeSlotsDark) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .sky_share = 0, .albedo = 0.98f, .seed = 2});
  MatrixAssembler assembler(test.world());
  const LocalMatrix& m = assembler.matrix();
  const auto solver = makeCpuGather(1);
  std::vector<Vec4> light;
  uint32_t freed = 0;
  for (const double chance : {1.0, 0.3, 0.9, 0.2}) {
    ASSERT_TRUE(assembler.update(test.randomCut(chance, 6)));
    ASSERT_TRUE(solver->update(m, assembler.change()));
    ASSERT_TRUE(solver->setSource(randomSource(m.slots(), 7)));
    std::vector<uint8_t> taken(m.slots());
    for (const SlotRange& range : m.tiles) std::fill_n(taken.begin() + range.first_slot, range.nodes, uint8_t{1});
    for (int steps = 28; steps < 34; ++steps) {  // whichever list ends up in front
      ASSERT_TRUE(solver->approach(steps));
      light.resize(m.slots());
      ASSERT_TRUE(solver->radiosity(light));
      for (uint32_t s = 0; s < m.slots(); ++s) {
        if (taken[s]) continue;
        ++freed;
        ASSERT_EQ(light[s].x + light[s].y + light[s].z, 0) << "slot " << s;
      }
    }
  }
  EXPECT_GT(freed, 100u);
}

TEST(CpuGather, AWarmStartFromTheSolutionStaysThere) {
  const TestWorld test({.side = 16, .tile_nodes = 12});
  const auto matrix = solverMatrix(test, test.randomCut(0.6, 3));
  const std::vector<Vec4> source = randomSource(matrix->slots(), 4);
  const auto solver = makeCpuGather(2);
  const std::vector<Vec4> settled = solve(*solver, matrix, source, 400);
  ASSERT_TRUE(setMatrix(*solver, *matrix, settled));
  ASSERT_TRUE(solver->setSource(source));
  std::vector<Vec4> after(matrix->slots());
  ASSERT_TRUE(solver->radiosity(after));
  for (size_t s = 0; s < after.size(); ++s) ASSERT_EQ(after[s].x, settled[s].x);
  ASSERT_TRUE(solver->iterate(1));
  ASSERT_TRUE(solver->radiosity(after));
  for (size_t s = 0; s < after.size(); ++s) ASSERT_NEAR(after[s].x, settled[s].x, 1e-5f * settled[s].x);
}

TEST(FullSolve, ClosedBoxHasTheFurnaceRadiosity) {
  for (const float rho : {0.5f, 0.9f}) {
    const TestWorld test({.side = 16, .tile_nodes = 12, .sky_share = 0, .albedo = rho});
    const std::vector<double> source(3 * test.world().levels()[0].nodes, 1.0);
    const auto solution = solveFullWorld(test.world(), source, {.tolerance = 1e-13});
    ASSERT_TRUE(solution) << solution.error().line();
    const double stored = static_cast<double>(test.node(0, 0).albedo.x);
    // The last change is below 1e-13 of B; what is left is at most rho / (1 - rho) = 9 times that.
    for (const double b : solution->radiosity) ASSERT_NEAR(b, 1 / (1 - stored), 1e-12 / (1 - stored));
  }
}

TEST(FullSolve, GivesTheSameBitsForEveryNumberOfThreads) {
  const TestWorld test({.side = 32, .tile_nodes = 60});
  std::vector<double> source(3 * test.world().levels()[0].nodes);
  for (size_t i = 0; i < source.size(); ++i) source[i] = static_cast<double>(i % 17);
  const auto one = solveFullWorld(test.world(), source, {.threads = 1});
  for (const int threads : {2, 5}) {
    const auto many = solveFullWorld(test.world(), source, {.threads = threads});
    ASSERT_EQ(one->iterations, many->iterations);
    ASSERT_EQ(one->radiosity, many->radiosity);
  }
}

TEST(CpuGather, WithEveryTileActiveEqualsTheFullSolve) {
  const TestWorld test({.side = 32, .tile_nodes = 60, .equal_areas = false, .seed = 6});
  const auto matrix = solverMatrix(test, test.randomCut(1, 1));
  const uint64_t patches = test.world().levels()[0].nodes;
  const std::vector<Vec4> source = randomSource(matrix->slots(), 4);
  std::vector<double> full_source;
  for (uint32_t i = 0; i < patches; ++i)  // level-0 tiles come first, so patches are slots
    for (const float m : {source[i].x, source[i].y, source[i].z}) full_source.push_back(static_cast<double>(m));
  const auto full = solveFullWorld(test.world(), full_source, {.tolerance = 1e-12});
  ASSERT_TRUE(full);
  const std::vector<Vec4> cut = solve(*makeCpuGather(2), matrix, source, 400);
  std::vector<std::array<double, 3>> expected(patches);
  for (uint32_t i = 0; i < patches; ++i)
    expected[i] = {full->radiosity[3 * i], full->radiosity[3 * i + 1], full->radiosity[3 * i + 2]};
  expectNear(std::span(cut).first(patches), expected, kRoundingTolerance);
}

TEST(CpuGather, ACoarseCutGathersTheExactMeanOfThePatchesFirstBounce) {
  // With equal areas and one albedo a cluster's row is the exact mean of its patches' rows. Where M is constant within
  // clusters, the first bounce F M is then the same at both levels (the second is not: B varies within a cluster).
  const TestWorld test({.side = 32, .tile_nodes = 60, .albedo = 0.5f, .seed = 6});
  const auto coarse = solverMatrix(test, test.randomCut(0, 1));  // the top level alone
  std::mt19937_64 random(3);
  std::vector<Vec4> source(coarse->slots());
  for (Vec4& s : source) s = {static_cast<float>(random() % 100), static_cast<float>(random() % 10), 1, 0};
  const std::vector<Vec4> one_bounce = solve(*makeCpuGather(1), coarse, source, 2);

  // The same two iterations on the patches, each emitting as its top cluster does.
  const auto fine = solverMatrix(test, test.randomCut(1, 1));
  std::vector<Vec4> fine_source(fine->slots());
  for (uint32_t i = 0; i < test.world().levels()[0].nodes; ++i) {
    uint32_t node = i;
    for (uint32_t level = 0; level < test.top(); ++level) node = test.world().parent(level, node);
    fine_source[i] = source[node];
  }
  const std::vector<Vec4> fine_bounce = solve(*makeCpuGather(1), fine, fine_source, 2);
  const uint32_t top_first = fine->slotOf(test.top(), 0);
  for (uint32_t n = 0; n < coarse->slots(); ++n)
    ASSERT_NEAR(fine_bounce[top_first + n].x, one_bounce[n].x, 1e-5f * one_bounce[n].x);
}

TEST(NodeValues, AreAreaWeightedMeansOfThePatchesBeneath) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .equal_areas = false});
  const uint64_t patches = test.world().levels()[0].nodes;
  std::vector<Vec3> values;
  for (uint32_t i = 0; i < patches; ++i) values.push_back({static_cast<float>(i), 1, static_cast<float>(i % 3)});
  const auto areas = patchAreas(test.world());
  ASSERT_TRUE(areas);
  const NodeValues up = aggregateUp(test.world(), *areas, values);
  for (uint32_t level = 0; level <= test.top(); ++level)
    for (uint32_t node = 0; node < test.world().levels()[level].nodes; ++node) {
      double area = 0, sum = 0;
      for (uint32_t i = 0; i < patches; ++i) {
        uint32_t ancestor = i;
        for (uint32_t l = 0; l < level; ++l) ancestor = test.world().parent(l, ancestor);
        if (ancestor != node) continue;
        area += static_cast<double>(test.node(0, i).area_m2);
        sum += static_cast<double>(test.node(0, i).area_m2) * i;
      }
      ASSERT_NEAR(up.area_m2[level][node], area, 1e-9);
      ASSERT_NEAR(static_cast<double>(up.mean[level][node].x), sum / area, 1e-4);
      ASSERT_NEAR(static_cast<double>(up.mean[level][node].y), 1.0, 1e-6);
    }
}

TEST(WorkerPool, CallsEveryPartOnceAgainAndAgain) {
  WorkerPool pool(3);
  for (uint32_t parts : {0u, 1u, 2u, 100u}) {
    for (int repeat = 0; repeat < 200; ++repeat) {
      std::vector<std::atomic<int>> calls(parts);
      pool.run(parts, [&](uint32_t part) { ++calls[part]; });
      for (const auto& c : calls) ASSERT_EQ(c.load(), 1);
    }
  }
}

// Command buffers of a caller's may still use what the first solver holds.
TEST(Fallback, TheSolverThatFailsStaysUntilTheEndAndIsAskedNoMore) {
  class Failing final : public Solver {
   public:
    Failing(int& calls, bool& gone) : calls_(calls), gone_(gone) {}
    ~Failing() override { gone_ = true; }
    Result<void> update(const LocalMatrix&, const MatrixChange&) override { return lost(); }
    bool resolvesRows() const override { return false; }
    Result<void> setSource(std::span<const Vec4>) override { return lost(); }
    Result<void> setRadiosity(std::span<const Vec4>) override { return lost(); }
    Result<void> iterate(int) override { return lost(); }
    Result<void> radiosity(std::span<Vec4>) override { return lost(); }
    double lastMs() const override { return 0; }
    const char* name() const override { return "failing"; }

   private:
    Result<void> lost() {
      ++calls_;
      return Error{ErrorCode::kIo, "", "", "lost", "", ErrorCause::kDeviceLost};
    }
    int& calls_;
    bool& gone_;
  };
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 3});
  const auto matrix = solverMatrix(test, test.randomCut(0.5, 1));
  const std::vector<Vec4> source = randomSource(matrix->slots(), 1);
  int calls = 0;
  bool gone = false;
  auto solver = makeFallbackSolver(std::make_unique<Failing>(calls, gone), makeCpuGather(1));
  EXPECT_STREQ(solver->name(), "failing");
  const std::vector<Vec4> light = solve(*solver, matrix, source, 8);
  EXPECT_STREQ(solver->name(), "cpu");
  EXPECT_EQ(calls, 1);
  EXPECT_FALSE(gone);
  const auto cpu = makeCpuGather(1);
  const std::vector<Vec4> expected = solve(*cpu, matrix, source, 8);
  for (size_t slot = 0; slot < light.size(); ++slot) ASSERT_EQ(light[slot].x, expected[slot].x);
  solver.reset();
  EXPECT_TRUE(gone);
}

class FailsLater final : public Solver {
 public:
  explicit FailsLater(int calls) : left_(calls), cpu_(makeCpuGather(1)) {}
  Result<void> update(const LocalMatrix& m, const MatrixChange& change) override { return call([&] { return cpu_->update(m, change); }); }
  bool resolvesRows() const override { return cpu_->resolvesRows(); }
  Result<void> setSource(std::span<const Vec4> source) override { return call([&] { return cpu_->setSource(source); }); }
  Result<void> setEnteredSource(std::span<const Vec4> source, const MatrixChange& change, bool stays) override { return call([&] { return cpu_->setEnteredSource(source, change, stays); }); }
  Result<void> setRadiosity(std::span<const Vec4> b) override { return call([&] { return cpu_->setRadiosity(b); }); }
  Result<void> iterate(int k) override { return call([&] { return cpu_->iterate(k); }); }
  Result<void> radiosity(std::span<Vec4> out) override { return call([&] { return cpu_->radiosity(out); }); }
  double lastMs() const override { return 0; }
  const char* name() const override { return "fails later"; }

 private:
  template <class Call>
  Result<void> call(Call&& made) {
    if (left_-- > 0) return made();
    return Error{ErrorCode::kIo, "", "", "lost", "", ErrorCause::kDeviceLost};
  }
  int left_;
  std::unique_ptr<Solver> cpu_;
};

// Wherever in a walk the first solver fails, the second knows the sources of all nodes, though each cut came with those of what entered.
TEST(Fallback, TheSecondSolverKnowsTheSourcesOfAllNodes) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 3});
  constexpr int kCuts = 4, kCalls = 3 * kCuts;  // update, sources, a step
  for (int calls = 0; calls < kCalls; ++calls) {
    auto solver = makeFallbackSolver(std::make_unique<FailsLater>(calls), makeCpuGather(1));
    MatrixAssembler assembler(test.world());
    const LocalMatrix& m = assembler.matrix();
    const auto source = [&] {  // by node, the same in every cut
      std::vector<Vec4> by_slot(m.slots());
      for (const SlotRange& range : m.tiles)
        for (uint32_t i = 0; i < range.nodes; ++i) by_slot[range.first_slot + i] = {static_cast<float>(1 + (range.first_node + i) % 7), 1, static_cast<float>(range.id.level), 0};
      return by_slot;
    };
    for (uint64_t cut = 0; cut < kCuts; ++cut) {
      ASSERT_TRUE(assembler.update(test.randomCut(0.5, cut)));
      ASSERT_TRUE(solver->update(m, assembler.change()));
      ASSERT_TRUE(cut == 0 ? solver->setSource(source()) : solver->setEnteredSource(source(), assembler.change(), false));
      ASSERT_TRUE(solver->iterate(1));
    }
    EXPECT_STREQ(solver->name(), "cpu");
    ASSERT_TRUE(solver->iterate(300));
    std::vector<Vec4> light(m.slots());
    ASSERT_TRUE(solver->radiosity(light));
    EXPECT_LT(differenceOf(m, light, converged(m, source())), 1e-5) << "after " << calls << " calls";
  }
}

}  // namespace
}  // namespace ff::runtime
