#include "runtime/dense/bounce_kernels.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/seed_kernels.h"
#include "tests/runtime/dense/bounce_matrix_driver.h"

namespace ff::runtime {
namespace {

std::unique_ptr<BounceMatrix> seed(uint32_t places) {
  auto made = makeCpuSeed({.places = places, .threads = 2});
  if (!made) throw std::runtime_error(made.error().line());
  return std::move(*made);
}

// Equations (1) to (5) on dense matrices in double precision, one channel.
class PaperByHand {
 public:
  explicit PaperByHand(uint32_t n) : n_(n), g_(n * n), colour_(n), in_(n) {}
  void enter(uint32_t p, double rho, const std::function<double(uint32_t, uint32_t)>& f) {
    double twice = 0;
    for (uint32_t i = 0; i < n_; ++i)
      if (in_[i]) twice += f(p, i) * colour_[i] * f(i, p);
    std::vector<double> col(n_), row(n_);
    for (uint32_t i = 0; i < n_; ++i) {
      if (!in_[i]) continue;
      col[i] = f(i, p) * (1 + rho * twice);
      row[i] = f(p, i) * (1 + rho * twice);
      for (uint32_t j = 0; j < n_; ++j) {
        if (!in_[j]) continue;
        col[i] += g_[i * n_ + j] * colour_[j] * f(j, p) * (1 + rho * twice);
        row[i] += f(p, j) * (1 + rho * twice) * colour_[j] * g_[j * n_ + i];
      }
    }
    for (uint32_t i = 0; i < n_; ++i)
      for (uint32_t j = 0; j < n_; ++j) g_[i * n_ + j] += col[i] * rho * row[j];
    for (uint32_t i = 0; i < n_; ++i) g_[i * n_ + p] = col[i], g_[p * n_ + i] = row[i];
    g_[p * n_ + p] = twice;
    colour_[p] = rho;
    in_[p] = true;
  }
  void leave(uint32_t p) {
    for (uint32_t i = 0; i < n_; ++i) g_[i * n_ + p] = g_[p * n_ + i] = 0;
    colour_[p] = 0;
    in_[p] = false;
  }
  double lit(uint32_t i, std::span<const Vec4> source) const {
    double sum = 0;
    for (uint32_t j = 0; j < n_; ++j) sum += g_[i * n_ + j] * static_cast<double>(source[j].x);
    return sum;
  }

 private:
  uint32_t n_;
  std::vector<double> g_, colour_;
  std::vector<bool> in_;
};

TEST(CpuSeed, DoesWhatTheEquationsSayAlsoWhenBlocksEnterAndLeave) {
  const uint32_t n = 90;
  const SceneRows scene = makeScene({.patches = n, .entries_per_row = 20});
  std::vector<double> f(n * n);
  for (uint32_t i = 0; i < n; ++i)
    for (uint32_t e = scene.row_start[i]; e < scene.row_start[i + 1]; ++e)
      f[i * n + scene.columns[e]] = static_cast<double>(scene.row_values[e]);
  const auto matrix = seed(n);
  Placement at(scene, n);
  PaperByHand paper(n);  // by patch
  const auto both = [&](std::span<const uint32_t> patches) {
    enter(*matrix, at, patches, 32);
    for (const uint32_t p : patches)
      paper.enter(p, static_cast<double>(scene.albedo[p].x), [&](uint32_t i, uint32_t j) { return f[i * n + j]; });
  };
  both(upTo(80));
  const std::vector<uint32_t> leaving{3, 60, 20, 21};
  leave(*matrix, at, leaving);
  for (const uint32_t p : leaving) paper.leave(p);
  both(std::vector<uint32_t>{85, 3, 88});
  const std::vector<Vec4> by_patch = randomLight(n, 1);
  std::vector<Vec4> source(n);
  for (uint32_t p = 0; p < n; ++p)
    if (at.place(p) != Placement::kNone) source[at.place(p)] = by_patch[p];
  std::vector<Vec4> only_present(n);
  for (uint32_t p = 0; p < n; ++p)
    if (at.place(p) != Placement::kNone) only_present[p] = by_patch[p];
  const std::vector<Vec4> lit = relit(*matrix, source);
  double difference = 0, norm = 0;
  for (uint32_t p = 0; p < n; ++p) {
    if (at.place(p) == Placement::kNone) continue;
    const double expected = paper.lit(p, only_present), got = static_cast<double>(lit[at.place(p)].x);
    difference += (expected - got) * (expected - got);
    norm += expected * expected;
  }
  EXPECT_LE(std::sqrt(difference / norm), 3e-3) << "fp16: up to 2^-12 of an entry in each of 83 updates, at random";
  EXPECT_GT(norm, 0);
}

TEST(CpuSeed, DriftsWhereTheExactMatrixDoesNot) {
  const SceneRows scene = makeScene({.patches = 400, .entries_per_row = 60});
  Placement at(scene, 200);
  const auto matrix = seed(200);
  Walk walk(WalkKind::kStraight, 400, 200, 8, 1);
  enter(*matrix, at, walk.present(), 64);
  const std::vector<Vec4> source = randomLight(200, 1);
  const double fresh = relativeError(relit(*matrix, source), exactIrradiance(at, source));
  for (int step = 0; step < 100; ++step) {
    const Walk::Step moved = walk.next();
    leave(*matrix, at, moved.leaving);
    enter(*matrix, at, moved.entering, 8);
  }
  const double walked = relativeError(relit(*matrix, source), exactIrradiance(at, source));
  EXPECT_LT(fresh, 0.1);
  EXPECT_GT(walked, fresh);
  EXPECT_GT(walked, 0.01) << "the baseline has become exact: is it still the paper's?";
}

TEST(CpuSeed, ChangingSomeLightsGivesWhatLightingAnewGives) {
  const SceneRows scene = makeScene({.patches = 100, .entries_per_row = 20});
  Placement at(scene, 100);
  const auto matrix = seed(100);
  enter(*matrix, at, upTo(90), 64);
  std::vector<Vec4> source = randomLight(100, 1);
  std::vector<Vec4> irradiance = relit(*matrix, source);
  source[5].x += 2;
  source[77].z += 1;
  ASSERT_TRUE(
      matrix->relightChanged(std::vector<uint32_t>{5, 77}, std::vector<Vec4>{{2, 0, 0, 0}, {0, 0, 1, 0}}, irradiance));
  EXPECT_LE(relativeError(irradiance, asDouble(relit(*matrix, source))), 1e-5);
}

TEST(CpuPlainLocal, IsTheFirstBouncesOfTheExactSolution) {
  const SceneRows scene = makeScene({.patches = 200, .entries_per_row = 30});
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    Placement at(scene, 160);
    auto made = makeCpuPlainLocal({.places = 160, .storage = storage, .threads = 2}, 60);  // 0.75^60 = 3e-8
    ASSERT_TRUE(made);
    enter(**made, at, upTo(160), 64);
    leave(**made, at, std::vector<uint32_t>{0, 17, 80});
    enter(**made, at, std::vector<uint32_t>{170, 17}, 64);
    const std::vector<Vec4> source = randomLight(160, 1);
    const std::vector<Rgb> exact = exactIrradiance(at, source);
    const double rounding = storage == Storage::kFloat32 ? 2e-6 : 1e-3;
    EXPECT_LE(relativeError(relit(**made, source), exact), rounding);
    auto three = makeCpuPlainLocal({.places = 160, .storage = storage, .threads = 2});
    ASSERT_TRUE(three);
    Placement again(scene, 160);
    enter(**three, again, upTo(160), 64);
    const double missing = relativeError(relit(**three, source), exactIrradiance(again, source));
    EXPECT_GT(missing, 0.01) << "three bounces are not all of them";
    EXPECT_LT(missing, 0.5);
  }
}

TEST(SeedKernels, Avx2AndPortableAgree) {
  if (!haveAvx2Kernels()) GTEST_SKIP() << "no AVX2, FMA and F16C here";
  const SeedKernels portable = portableSeedKernels(), fast = avx2SeedKernels();
  const uint32_t rows = 90, columns = 33;
  const size_t stride = 96;
  const std::vector<Vec4> values = randomLight(stride * columns, 1), factor = randomLight(96, 2),
                          col = randomLight(96, 3);
  std::vector<Half4> matrix(stride * columns);
  for (size_t i = 0; i < matrix.size(); ++i)
    matrix[i] = {toHalf(values[i].x), toHalf(values[i].y), toHalf(values[i].z), {}};
  std::vector<Vec4> a(96), b(96);
  portable.multiply(matrix.data(), stride, 2, rows, columns, factor.data(), a.data());
  fast.multiply(matrix.data(), stride, 2, rows, columns, factor.data(), b.data());
  EXPECT_LE(relativeError(b, asDouble(a)), 1e-6);
  portable.multiplyLeft(matrix.data(), stride, rows, 1, columns, factor.data(), a.data());
  fast.multiplyLeft(matrix.data(), stride, rows, 1, columns, factor.data(), b.data());
  EXPECT_LE(relativeError(b, asDouble(a)), 1e-6);
  std::vector<Half4> m0 = matrix, m1 = matrix;
  portable.addOuter(m0.data(), stride, rows, 1, columns, col.data(), factor.data());
  fast.addOuter(m1.data(), stride, rows, 1, columns, col.data(), factor.data());
  for (size_t i = 0; i < m0.size(); ++i) {
    ASSERT_NEAR(toFloat(m0[i].y), toFloat(m1[i].y), 1e-3f * (0.1f + toFloat(m0[i].y)));
    ASSERT_NEAR(toFloat(m0[i].x), toFloat(m1[i].x), 1e-3f * (0.1f + toFloat(m0[i].x)));
  }
}

}  // namespace
}  // namespace ff::runtime
