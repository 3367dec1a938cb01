// What every BounceMatrix must do, whoever computes it: include this and instantiate BounceMatrixTest with a factory.
#pragma once
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <ostream>
#include <string>

#include "tests/runtime/dense/bounce_matrix_driver.h"

namespace ff::runtime {

struct BounceCase {
  std::string name;  // letters and digits
  std::function<Result<std::unique_ptr<BounceMatrix>>(const MultibounceSettings&)> make;
  Storage storage = Storage::kFloat32;
  bool luminance = false;
  // Of relight() against the exact irradiance, relative L2, after tens of updates of a few hundred places with light
  // multiplied about threefold. fp32: 2^-24 an operation, some hundred operations deep. fp16: 2^-12 an entry and
  // update at the most, which averages out over a row's entries. Luminance is an approximation and is measured.
  double tolerance() const { return luminance ? 1e-2 : storage == Storage::kFloat32 ? 5e-6 : 2e-3; }
  friend void PrintTo(const BounceCase& c, std::ostream* out) { *out << c.name; }
};

class BounceMatrixTest : public ::testing::TestWithParam<BounceCase> {
 protected:
  std::unique_ptr<BounceMatrix> make(uint32_t places, bool time_slice = false) const {
    auto made = GetParam().make({.places = places,
                                 .storage = GetParam().storage,
                                 .luminance = GetParam().luminance,
                                 .time_slice = time_slice,
                                 .threads = 2});
    if (!made) throw std::runtime_error(made.error().line());
    return std::move(*made);
  }
};

TEST_P(BounceMatrixTest, IsTheDirectSolutionAfterAnyWalkWithBlocksOfAnySize) {
  const SceneRows scene = makeScene({.patches = 400, .entries_per_row = 40});
  for (const uint32_t block : {1u, 2u, 7u, 16u, 33u, 64u}) {
    Placement at(scene, 150);
    const auto matrix = make(150);
    Walk walk(WalkKind::kRandom, 400, 140, block, block);
    enter(*matrix, at, walk.present(), block);
    for (int step = 0; step < 12; ++step) {
      const Walk::Step moved = walk.next();
      leave(*matrix, at, moved.leaving);
      enter(*matrix, at, moved.entering, block);
    }
    const std::vector<Vec4> source = randomLight(150, block);
    EXPECT_LE(relativeError(relit(*matrix, source), exactIrradiance(at, source)), GetParam().tolerance())
        << "blocks of " << block;
    EXPECT_EQ(matrix->stats().clamped, 0u);
  }
}

TEST_P(BounceMatrixTest, BlocksOfChangingSizesThatLeaveHolesAndRefillThem) {
  const SceneRows scene = makeScene({.patches = 300, .entries_per_row = 30, .seed = 4});
  Placement at(scene, 300);
  const auto matrix = make(300);
  std::mt19937_64 random(9);
  std::vector<uint32_t> in, out = upTo(300);
  for (int step = 0; step < 30; ++step) {
    auto& from = random() % 3 != 0 ? out : in;
    const bool entering = &from == &out;
    std::vector<uint32_t> some;
    for (uint64_t k = 1 + random() % 64; k > 0 && !from.empty(); --k) {
      std::swap(from[random() % from.size()], from.back());
      some.push_back(from.back());
      from.pop_back();
    }
    if (some.empty()) continue;
    entering ? enter(*matrix, at, some, 64) : leave(*matrix, at, some);
    auto& to = entering ? in : out;
    to.insert(to.end(), some.begin(), some.end());
    if (step % 5 != 4) continue;
    const std::vector<Vec4> source = randomLight(300, random());
    ASSERT_LE(relativeError(relit(*matrix, source), exactIrradiance(at, source)), GetParam().tolerance()) << step;
  }
}

TEST_P(BounceMatrixTest, LeavesMoreThanABlockAtOnceAndComesBackToEmpty) {
  const SceneRows scene = makeScene({.patches = 200, .entries_per_row = 30, .seed = 5});
  Placement at(scene, 200);
  const auto matrix = make(200);
  enter(*matrix, at, upTo(200), 64);
  leave(*matrix, at, upTo(150));
  const std::vector<Vec4> source = randomLight(200, 3);
  EXPECT_LE(relativeError(relit(*matrix, source), exactIrradiance(at, source)), GetParam().tolerance());
  std::vector<uint32_t> rest;
  for (uint32_t p = 150; p < 200; ++p) rest.push_back(p);
  leave(*matrix, at, rest);
  for (const Vec4& e : relit(*matrix, source)) ASSERT_EQ(e.x + e.y + e.z, 0);
  EXPECT_EQ(matrix->stats().entered, 200u);
  EXPECT_EQ(matrix->stats().left, 200u);
}

TEST_P(BounceMatrixTest, FreePlacesAreDarkAndSendNothing) {
  const SceneRows scene = makeScene({.patches = 100, .entries_per_row = 20});
  Placement at(scene, 128);
  const auto matrix = make(128);
  enter(*matrix, at, upTo(100), 50);
  leave(*matrix, at, std::vector<uint32_t>{3, 50, 99});
  std::vector<Vec4> source(128);
  for (uint32_t i = 0; i < 128; ++i)
    if (at.patch(i) == Placement::kNone) source[i] = {1, 1, 1, 0};
  for (const Vec4& e : relit(*matrix, source)) ASSERT_EQ(e.x + e.y + e.z, 0);
  for (Vec4& s : source) s = {1, 1, 1, 0};
  const std::vector<Vec4> lit = relit(*matrix, source);
  for (uint32_t i = 0; i < 128; ++i) ASSERT_EQ(at.patch(i) == Placement::kNone, lit[i].x == 0) << i;
}

TEST_P(BounceMatrixTest, ClearForgetsEverything) {
  const SceneRows scene = makeScene({.patches = 100, .entries_per_row = 20});
  Placement first(scene, 100), second(scene, 100);
  const auto matrix = make(100, true);
  enter(*matrix, first, upTo(100), 64);
  ASSERT_TRUE(matrix->clear());
  const std::vector<Vec4> source = randomLight(100, 1);
  for (const Vec4& e : relit(*matrix, source)) ASSERT_EQ(e.x + e.y + e.z, 0);
  enter(*matrix, second, upTo(80), 64);
  EXPECT_LE(relativeError(relit(*matrix, source), exactIrradiance(second, source)), GetParam().tolerance());
}

TEST_P(BounceMatrixTest, AnUpdateSpreadOverFramesIsExactAtEveryFrontier) {
  const SceneRows scene = makeScene({.patches = 300, .entries_per_row = 30, .seed = 2});
  Placement at(scene, 200);
  const auto matrix = make(200, true);
  enter(*matrix, at, upTo(180), 64);
  const std::vector<Vec4> source = randomLight(200, 1);
  const auto checkAll = [&](const char* what) {
    const std::vector<Rgb> exact = exactIrradiance(at, source);
    for (uint32_t left = 1; left > 0;) {
      ASSERT_LE(relativeError(relit(*matrix, source), exact), GetParam().tolerance())
          << what << ", " << left << " left";
      const auto advanced = matrix->advance(13);
      ASSERT_TRUE(advanced);
      left = *advanced;
      ASSERT_EQ(left, matrix->stats().pending_columns);
    }
    ASSERT_LE(relativeError(relit(*matrix, source), exact), GetParam().tolerance()) << what;
  };
  checkAll("entered");
  std::vector<uint32_t> leaving, entering;
  for (uint32_t i = 0; i < 40; ++i) leaving.push_back(3 * i), entering.push_back(180 + i);
  leave(*matrix, at, leaving);
  checkAll("left");
  enter(*matrix, at, entering, 64);
  checkAll("entered again");
  // The next update comes while the last one is half way.
  leave(*matrix, at, std::vector<uint32_t>{1, 2, 4, 5});
  ASSERT_TRUE(matrix->advance(50));
  enter(*matrix, at, std::vector<uint32_t>{4, 1, 0}, 64);
  ASSERT_TRUE(matrix->advance(50));
  leave(*matrix, at, std::vector<uint32_t>{7});
  checkAll("several");
}

TEST_P(BounceMatrixTest, ChangingSomeLightsGivesWhatLightingAnewGives) {
  const SceneRows scene = makeScene({.patches = 200, .entries_per_row = 30, .seed = 3});
  Placement at(scene, 200);
  const auto matrix = make(200, true);
  enter(*matrix, at, upTo(190), 64);  // the last block stays pending
  ASSERT_TRUE(matrix->advance(100));
  std::vector<Vec4> source = randomLight(200, 1);
  std::vector<Vec4> irradiance = relit(*matrix, source);
  const std::vector<uint32_t> places{150, 3, 99, 100, 189, 17};
  const std::vector<Vec4> difference = {{1, 0, 0, 0}, {0, 2, 0, 0}, {1, 1, 3, 0},
                                        {0, 0, 0, 0}, {5, 0, 1, 0}, {-0.1f, 0, 0, 0}};
  for (size_t i = 0; i < places.size(); ++i) {
    source[places[i]].x += difference[i].x;
    source[places[i]].y += difference[i].y;
    source[places[i]].z += difference[i].z;
  }
  ASSERT_TRUE(matrix->relightChanged(places, difference, irradiance));
  EXPECT_LE(relativeError(irradiance, asDouble(relit(*matrix, source))), 1e-5);
}

TEST_P(BounceMatrixTest, TakesPatchesThatNobodySeesThatSeeNothingAndThatAreThereTwice) {
  SceneSettings settings{.patches = 120, .entries_per_row = 30};
  std::vector<FormFactorRow> rows = makeRows(settings);
  for (FormFactorRow& row : rows)  // 5: zero area; its row stays
    std::erase_if(row, [](const auto& entry) { return entry.first == 5; });
  rows[6].clear();    // sees only sky
  rows[8] = rows[7];  // the same receiver twice
  const SceneRows scene = makeSceneRows(rows, makeAlbedos(settings));
  Placement placement(scene, 120);
  const auto matrix = make(120);
  enter(*matrix, placement, upTo(120), 11);
  leave(*matrix, placement, std::vector<uint32_t>{7, 5});
  enter(*matrix, placement, std::vector<uint32_t>{5, 7}, 2);
  const std::vector<Vec4> source = randomLight(120, 1);
  EXPECT_LE(relativeError(relit(*matrix, source), exactIrradiance(placement, source)), GetParam().tolerance());
}

// Pairs that send each other 98 % or more of their light and reflect 98 %: S C = 0.96, light multiplied 25-fold.
TEST_P(BounceMatrixTest, TinyEnclosuresThatKeepAlmostAllLight) {
  const SceneRows scene =
      makeScene({.kind = SceneKind::kEnclosures, .patches = 200, .entries_per_row = 20, .albedo = 0.98f});
  Placement at(scene, 160);
  const auto matrix = make(160);
  Walk walk(WalkKind::kStraight, 200, 160, 5, 1);  // odd: partners come and go at different times
  enter(*matrix, at, walk.present(), 7);
  for (int step = 0; step < 40; ++step) {
    const Walk::Step moved = walk.next();
    leave(*matrix, at, moved.leaving);
    enter(*matrix, at, moved.entering, 5);
  }
  const std::vector<Vec4> source = randomLight(160, 1);
  EXPECT_LE(relativeError(relit(*matrix, source), exactIrradiance(at, source)), 25 * GetParam().tolerance());
}

// All rows sum to 1 and all sources to 1 W/m2: E = 1 / (1 - rho) everywhere, however the box was filled. Closing the
// box multiplies the rounding of S by up to 1 / (1 - rho); opening it again leaves differences of values that are
// 1 / (1 - rho) times larger: together its square, averaged over the entries of a row.
TEST_P(BounceMatrixTest, AClosedBoxHoldsExactlyItsEnergyAndNeverMore) {
  for (const float albedo : {0.5f, 0.9f, 0.98f}) {
    const SceneRows scene =
        makeScene({.kind = SceneKind::kClosedBox, .patches = 192, .entries_per_row = 60, .albedo = albedo});
    Placement at(scene, 192);
    const auto matrix = make(192);
    enter(*matrix, at, upTo(192), 48);
    const double full = 1 / (1 - static_cast<double>(albedo));
    const double epsilon = GetParam().storage == Storage::kFloat32 ? 0x1p-24 : 0x1p-12;
    const auto check = [&](const char* when, double tolerance) {
      for (const Vec4& e : relit(*matrix, std::vector<Vec4>(192, {1, 1, 1, 0})))
        for (const float x : {e.x, e.y, e.z})
          ASSERT_NEAR(static_cast<double>(x) / full, 1, tolerance) << when << ", albedo " << albedo;
    };
    check("filled", 5 * epsilon * full);
    Walk walk(WalkKind::kRandom, 192, 192, 16, 1);
    for (int step = 0; step < 20; ++step) {
      const Walk::Step moved = walk.next();
      leave(*matrix, at, moved.leaving);
      enter(*matrix, at, moved.entering, 16);
    }
    check("walked", std::min(0.2, epsilon * full * full + 5 * epsilon * full));
    EXPECT_EQ(matrix->stats().clamped, 0u);
  }
}

// 0.999 in a closed box is past what fp16 can carry through comings and goings, and costs fp32 its last digits. What is
// asked: a block is taken or refused with a message, nothing is ever NaN or glows, and fp32 takes all of them.
TEST_P(BounceMatrixTest, WhereLightIsMultipliedAThousandfoldABlockIsTakenOrRefusedAndNothingGlows) {
  const SceneRows scene =
      makeScene({.kind = SceneKind::kClosedBox, .patches = 192, .entries_per_row = 60, .albedo = 0.999f});
  const bool fp32 = GetParam().storage == Storage::kFloat32;
  Placement at(scene, 192);
  const auto matrix = make(192);
  const std::vector<Vec4> ones(192, {1, 1, 1, 0});
  int refused = 0;
  const auto enterOrRefuse = [&](std::span<const uint32_t> patches) {
    const auto done = matrix->insert(at.enter(patches));
    if (!done) {
      EXPECT_FALSE(done.error().message.empty());
      (void)at.leave(patches);
      ++refused;
    }
    return static_cast<bool>(done);
  };
  const auto check = [&] {
    for (const Vec4& e : relit(*matrix, ones)) {
      ASSERT_TRUE(std::isfinite(e.x + e.y + e.z));
      ASSERT_GE(e.x, 0);
      ASSERT_LE(e.x, fp32 ? 1100 : 8192);
    }
  };
  const std::vector<uint32_t> all = upTo(192);
  for (uint32_t i = 0; i < 192; i += 16) enterOrRefuse(std::span(all).subspan(i, 16));
  check();
  std::mt19937_64 random(1);
  for (int step = 0; step < 20; ++step) {
    std::vector<uint32_t> in, out;
    for (uint32_t p = 0; p < 192; ++p) (at.place(p) == Placement::kNone ? out : in).push_back(p);
    for (uint32_t i = 0; i < 16; ++i) std::swap(in[i], in[i + random() % (in.size() - i)]);
    in.resize(16);
    leave(*matrix, at, in);
    out.resize(std::min<size_t>(out.size(), 16));
    if (!out.empty()) enterOrRefuse(out);
    enterOrRefuse(in);
    check();
  }
  if (fp32) {
    EXPECT_EQ(refused, 0);
    for (const Vec4& e : relit(*matrix, ones)) ASSERT_NEAR(e.x, 1000, 0x1p-24 * 1e6 * 1000);
  }
}

TEST_P(BounceMatrixTest, LowersAlbedosOnlyWhereAllLightWouldBeKept) {
  // White all over, but 8 % of the light leaves: nothing to lower.
  const SceneRows open = makeScene({.patches = 100, .entries_per_row = 20, .albedo = 1});
  Placement in_open(open, 100);
  const auto lit = make(100);
  enter(*lit, in_open, upTo(100), 20);
  EXPECT_EQ(lit->stats().clamped, 0u);
  const std::vector<Vec4> source = randomLight(100, 1);
  EXPECT_LE(relativeError(relit(*lit, source), exactIrradiance(in_open, source)), 12 * GetParam().tolerance());
  // Closed and white: without lowering the light would have no bound.
  const SceneRows closed =
      makeScene({.kind = SceneKind::kClosedBox, .patches = 100, .entries_per_row = 20, .albedo = 1});
  Placement in_closed(closed, 100);
  const auto white = make(100);
  enter(*white, in_closed, upTo(90), 30);
  EXPECT_LT(white->stats().clamped, 90u) << "columns are still missing";
  std::vector<uint32_t> last;
  for (uint32_t p = 90; p < 100; ++p) last.push_back(p);
  const auto done = white->insert(in_closed.enter(last));
  if (GetParam().storage == Storage::kFloat32) {
    EXPECT_TRUE(done) << done.error().line();
  }
  EXPECT_GT(white->stats().clamped, 0u);
  for (const Vec4& e : relit(*white, std::vector<Vec4>(100, {1, 1, 1, 0}))) {
    ASSERT_TRUE(std::isfinite(e.x));
    ASSERT_GE(e.x, 0);
    ASSERT_LE(e.x, 8192) << "lowered albedos multiply light by 2048 at the most";
  }
}

TEST_P(BounceMatrixTest, RefusesABlockThatWouldCatchLightAndStaysAsItWas) {
  const SceneRows scene = makeScene({.patches = 60, .entries_per_row = 20});
  Placement at(scene, 64);
  const auto matrix = make(64);
  enter(*matrix, at, upTo(60), 20);
  const std::vector<Vec4> source = randomLight(64, 1);
  const std::vector<Vec4> before = relit(*matrix, source);
  const std::vector<uint32_t> places{60, 61}, row_start{0, 1, 2}, columns{61, 60}, none{0, 0, 0};
  const std::vector<Vec4> albedo(2, {0.9f, 0.9f, 0.9f, 0});
  for (const float value : {1.3f, std::numeric_limits<float>::quiet_NaN(), -1.0f}) {  // 0.9 * 1.3 > 1
    const std::vector<float> values(2, value);
    const auto refused = matrix->insert({places, albedo, row_start, columns, values, none, {}, {}});
    ASSERT_FALSE(refused) << value;
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalidFile);
    EXPECT_FALSE(refused.error().message.empty());
    const std::vector<Vec4> after = relit(*matrix, source);
    for (size_t i = 0; i < after.size(); ++i) ASSERT_EQ(after[i].y, before[i].y) << i;
  }
  const std::vector<float> values(2, 0.9f);
  ASSERT_TRUE(matrix->insert({places, albedo, row_start, columns, values, none, {}, {}}));
}

}  // namespace ff::runtime
