#include "runtime/dense/bounce_kernels.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/small_inverse.h"
#include "tests/runtime/dense/bounce_matrix_cases.h"
#include "tests/support/counted_memory.h"

namespace ff::runtime {
namespace {

INSTANTIATE_TEST_SUITE_P(Cpu, BounceMatrixTest,
                         ::testing::Values(BounceCase{"Float32", makeCpuMultibounce, Storage::kFloat32},
                                           BounceCase{"Float16", makeCpuMultibounce, Storage::kFloat16},
                                           BounceCase{"Luminance", makeCpuMultibounce, Storage::kFloat32, true},
                                           BounceCase{"LuminanceFloat16", makeCpuMultibounce, Storage::kFloat16, true}),
                         [](const auto& test) { return test.param.name; });

TEST(CpuMultibounce, HasTheSameBitsForAnyNumberOfThreadsSlicedOrNot) {
  const SceneRows scene = makeScene({.patches = 700, .entries_per_row = 50});
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    std::vector<std::vector<Vec4>> lit;
    for (const int threads : {1, 2, 5})
      for (const bool slice : {false, true}) {
        auto made = makeCpuMultibounce({.places = 600, .storage = storage, .time_slice = slice, .threads = threads});
        ASSERT_TRUE(made);
        Placement at(scene, 600);
        Walk walk(WalkKind::kTeleports, 700, 590, 40, 1);
        enter(**made, at, walk.present(), 64);
        for (int step = 0; step < 6; ++step) {
          const Walk::Step moved = walk.next();
          leave(**made, at, moved.leaving);
          ASSERT_TRUE((*made)->advance(100));
          enter(**made, at, moved.entering, 64);
        }
        while (slice && *(*made)->advance(77) > 0) continue;
        lit.push_back(relit(**made, randomLight(600, 3)));
      }
    for (const auto& each : lit)
      for (size_t i = 0; i < each.size(); ++i) {
        ASSERT_EQ(each[i].x, lit[0][i].x);
        ASSERT_EQ(each[i].y, lit[0][i].y);
      }
  }
}

// Updates go on from factors that are not in the matrix yet, up to kMaxRank of them; a refused one leaves them alone.
TEST(CpuMultibounce, ManySmallUpdatesShareAPassAndAreExactInBetween) {
  const SceneRows scene = makeScene({.patches = 300, .entries_per_row = 40});
  auto made = makeCpuMultibounce({.places = 200, .time_slice = true, .threads = 2});
  ASSERT_TRUE(made);
  Placement at(scene, 200);
  enter(**made, at, upTo(120), kMaxBlock);
  while (*(*made)->advance(kMaxSlots) > 0) continue;
  const std::vector<Vec4> source = randomLight(200, 1);
  std::mt19937_64 random(3);
  std::vector<uint32_t> in = upTo(120), out;
  for (uint32_t p = 120; p < 300; ++p) out.push_back(p);
  for (uint32_t step = 0; step < 200; ++step) {  // grows, shrinks, and reuses places that left a moment ago
    const bool grow = step % 60 < 40 && !out.empty();
    auto &from = grow ? out : in, &to = grow ? in : out;
    const size_t pick = random() % from.size();
    const std::vector<uint32_t> one{from[pick]};
    to.push_back(one[0]);
    from.erase(from.begin() + static_cast<std::ptrdiff_t>(pick));
    if (grow && at.places() - in.size() < 2) break;
    grow ? enter(**made, at, one, 1) : leave(**made, at, one);
    if (step % 128 == 127) {
      EXPECT_GT((*made)->stats().pending_columns, 0u) << "128 single updates fit without a pass";
      const std::vector<uint32_t> places{198, 199}, row_start{0, 1, 2}, columns{199, 198}, none{0, 0, 0};
      const std::vector<Vec4> albedo(2, {0.9f, 0.9f, 0.9f, 0});
      const std::vector<float> values(2, 1.3f);
      EXPECT_FALSE((*made)->insert({places, albedo, row_start, columns, values, none, {}, {}}));
    }
    if (step % 10 == 9) {
      ASSERT_LE(relativeError(relit(**made, source), exactIrradiance(at, source)), 5e-6) << step;
    }
  }
  while (*(*made)->advance(29) > 0) continue;
  EXPECT_LE(relativeError(relit(**made, source), exactIrradiance(at, source)), 5e-6);
}

// The oscillation is the worst walk: nodes that stay gather the rounding of every update.
TEST(CpuMultibounce, AHundredThousandSwapsLeaveNoTrace) {
  const SceneRows scene = makeScene({.patches = 512, .entries_per_row = 60});
  const std::vector<Vec4> source = randomLight(256, 1);
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    auto made = makeCpuMultibounce({.places = 256, .storage = storage, .threads = 2});
    ASSERT_TRUE(made);
    Placement at(scene, 256);
    Walk walk(WalkKind::kOscillation, 512, 256, kMaxBlock, 1);
    enter(**made, at, walk.present(), kMaxBlock);
    for (uint32_t swaps = 0; swaps < 100000; swaps += kMaxBlock) {
      const Walk::Step moved = walk.next();
      leave(**made, at, moved.leaving);
      enter(**made, at, moved.entering, kMaxBlock);
    }
    const double error = relativeError(relit(**made, source), exactIrradiance(at, source));
    EXPECT_LE(error, storage == Storage::kFloat32 ? 1e-5 : 5e-3);
  }
}

TEST(CpuMultibounce, TakesNoMemoryAfterItWasMade) {
  const SceneRows scene = makeScene({.patches = 300, .entries_per_row = 30});
  for (const bool luminance : {false, true}) {
    auto made = makeCpuMultibounce({.places = 200, .luminance = luminance, .time_slice = true, .threads = 1});
    ASSERT_TRUE(made);
    Placement at(scene, 200);
    const std::vector<uint32_t> patches = upTo(180), some = upTo(30);
    std::vector<Vec4> source = randomLight(200, 1), irradiance(200);
    const auto counted = [&](auto&& call) {
      const MemoryCalls before = memoryCalls();
      const bool ok = static_cast<bool>(call());
      const MemoryCalls after = memoryCalls();
      EXPECT_TRUE(ok);
      EXPECT_EQ(after.allocated - before.allocated, 0u);
      EXPECT_EQ(after.freed - before.freed, 0u);
    };
    for (int round = 0; round < 2; ++round) {
      for (uint32_t i = 0; i < 180; i += 60) {
        const EnteringBlock block = at.enter(std::span(patches).subspan(i, 60));
        counted([&] { return (*made)->insert(block); });
      }
      counted([&] { return (*made)->relight(source, irradiance); });
      counted([&] { return (*made)->advance(20); });
      counted([&] { return (*made)->relightChanged(some, std::span(source).subspan(0, 30), irradiance); });
      const auto places = at.leave(patches);
      counted([&] { return (*made)->remove(places); });
      counted([&] { return (*made)->clear(); });
    }
  }
}

TEST(CpuMultibounce, RefusesSizesThatNoMatrixHas) {
  EXPECT_FALSE(makeCpuMultibounce({.places = 0}));
  EXPECT_FALSE(makeCpuMultibounce({.places = 1000000}));
}

TEST(Half, RoundTripsEveryValueAndRoundsToNearestEven) {
  for (uint32_t bits = 0; bits < 65536; ++bits) {
    const Half h{static_cast<uint16_t>(bits)};
    const bool nan = (bits & 0x7c00u) == 0x7c00u && (bits & 0x3ffu) != 0;
    if (nan) continue;
    ASSERT_EQ(toHalf(toFloat(h)).bits, h.bits);
    if ((bits & 0x7fffu) >= 0x7bffu) continue;
    // Half way to the next value: to the even one.
    const float here = toFloat(h), next = toFloat(Half{static_cast<uint16_t>(bits + 1)}), middle = (here + next) / 2;
    ASSERT_EQ(toHalf(middle).bits, bits % 2 == 0 ? bits : bits + 1) << bits;
    ASSERT_EQ(toHalf(std::nextafter(middle, here)).bits, bits);
    ASSERT_EQ(toHalf(std::nextafter(middle, next)).bits, bits + 1);
  }
  EXPECT_EQ(toHalf(65519.0f).bits, 0x7bff);
  EXPECT_EQ(toHalf(65520.0f).bits, 0x7c00);
}

TEST(SmallInverse, TimesTheMatrixIsOne) {
  std::mt19937_64 random(1);
  for (const uint32_t k : {1u, 2u, 17u, 64u}) {
    SmallMatrix a, copy, inverse, product;
    for (uint32_t i = 0; i < k; ++i)  // the diagonal is small: pivots must be looked for
      for (uint32_t j = 0; j < k; ++j) a(i, j) = i == j ? 1e-9 : static_cast<double>(random() >> 11) * 0x1p-53 - 0.5;
    if (k == 1) a(0, 0) = 3;
    copy = a;
    ASSERT_TRUE(invert(a, k, inverse));
    multiply(copy, inverse, k, product);
    for (uint32_t i = 0; i < k; ++i)
      for (uint32_t j = 0; j < k; ++j) ASSERT_NEAR(product(i, j), i == j ? 1 : 0, 1e-10);
  }
  SmallMatrix zero, inverse;
  EXPECT_FALSE(invert(zero, 2, inverse));
}

template <class Element>
void compareKernels() {
  if (!haveAvx2Kernels()) GTEST_SKIP() << "no AVX2, FMA and F16C here";
  const BounceKernels<Element> portable = portableKernels<Element>(), fast = avx2Kernels<Element>();
  std::mt19937_64 random(1);
  const auto uniform = [&] { return static_cast<float>(random() >> 40) / 16777216.0f; };
  const uint32_t rows = 176, columns = 48, k = 37;
  const size_t stride = 192;
  std::vector<Element> matrix(stride * columns);
  for (Element& m : matrix) {
    if constexpr (sizeof(Element) == 2)
      m = toHalf(uniform());
    else
      m = uniform();
  }
  std::vector<float> a(rows * kMaxRank), b(columns * kFactorStride), weight(rows), factor[3];
  for (auto* v : {&a, &b, &weight})
    for (float& x : *v) x = uniform();
  std::vector<uint32_t> start{0}, index, list;
  std::vector<float> value;
  for (uint32_t p = 0; p < k; ++p) {
    for (uint32_t e = 0; e < p % 7; ++e)
      index.push_back(static_cast<uint32_t>(random() % columns)), value.push_back(uniform());
    start.push_back(static_cast<uint32_t>(index.size()));
  }
  for (uint32_t i = 0; i < 23; ++i) list.push_back(static_cast<uint32_t>(random() % columns));
  for (auto& f : factor)
    for (uint32_t i = 0; i < 23; ++i) f.push_back(uniform());
  const SparseVectors vectors{k, start.data(), index.data(), value.data(), weight.data()};
  const auto same = [](const std::vector<float>& x, const std::vector<float>& y) {
    for (size_t i = 0; i < x.size(); ++i) ASSERT_NEAR(x[i], y[i], 1e-5f * (1 + std::abs(y[i]))) << i;
  };

  std::vector<Element> m0 = matrix, m1 = matrix;
  portable.addProduct(a.data(), k, b.data(), m0.data(), stride, 16, rows, 47);
  fast.addProduct(a.data(), k, b.data(), m1.data(), stride, 16, rows, 47);
  for (size_t i = 0; i < m0.size(); ++i) {
    if constexpr (sizeof(Element) == 2)
      ASSERT_NEAR(toFloat(m0[i]), toFloat(m1[i]), 1e-3f * (0.1f + toFloat(m0[i])));
    else
      ASSERT_NEAR(m0[i], m1[i], 1e-5f * (1 + m0[i]));
  }
  std::vector<float> e0[3], e1[3];
  for (auto* e : {&e0, &e1})
    for (auto& x : *e) x.assign(rows, 0.5f);
  portable.addColumns(matrix.data(), stride, 32, rows, list.data(), factor[0].data(), 23, e0[0].data());
  fast.addColumns(matrix.data(), stride, 32, rows, list.data(), factor[0].data(), 23, e1[0].data());
  same(e1[0], e0[0]);
  const float* const factors[3] = {factor[0].data(), factor[1].data(), factor[2].data()};
  float* const out0[3] = {e0[0].data(), e0[1].data(), e0[2].data()};
  float* const out1[3] = {e1[0].data(), e1[1].data(), e1[2].data()};
  portable.addColumns3(matrix.data(), stride, 16, rows, list.data(), factors, 23, out0);
  fast.addColumns3(matrix.data(), stride, 16, rows, list.data(), factors, 23, out1);
  for (int c = 0; c < 3; ++c) same(e1[c], e0[c]);
  std::vector<float> g0(rows * kMaxRank), g1(rows * kMaxRank);
  portable.gatherColumns(matrix.data(), stride, 0, rows, vectors, g0.data());
  fast.gatherColumns(matrix.data(), stride, 0, rows, vectors, g1.data());
  same(g1, g0);
  const std::vector<uint32_t> blocks{0, 1, 2, 3, 4, 5};
  std::vector<float> scratch(rows * kPanelRows), r0(columns * kFactorStride), r1(columns * kFactorStride);
  portable.gatherRows(matrix.data(), stride, 16, blocks.data(), 6, vectors, scratch.data(), r0.data());
  fast.gatherRows(matrix.data(), stride, 16, blocks.data(), 6, vectors, scratch.data(), r1.data());
  same(r1, r0);
}

TEST(BounceKernels, Avx2AndPortableAgreeOnFloats) { compareKernels<float>(); }
TEST(BounceKernels, Avx2AndPortableAgreeOnHalves) { compareKernels<Half>(); }

}  // namespace
}  // namespace ff::runtime
