// How many samples a row is given, against the spread of what rows with so many samples bring.
#include "bake/matrix/row_samples.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "bake/matrix/row_sampling.h"
#include "formats/model.h"
#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

// Node 0 faces 4000 others: the sky lights `bright` of them, evenly among the rest, and a lamp every `lit`th.
class OneRow {
 public:
  static constexpr uint32_t kOthers = 4000;
  OneRow(uint32_t bright, uint32_t lit) : bright_(bright), lit_(lit) {}
  uint32_t nodes() const { return kOthers + 1; }
  void row(uint32_t node, ExchangeRow& out) const {
    out = {};
    if (node == 0) {
      for (uint32_t j = 1; j <= kOthers; ++j) {
        out.column.push_back(j);
        out.area_m2.push_back((1 + 0.9 * std::sin(j)) / kOthers);
      }
      return;
    }
    if (isBright(node)) out.sky_m2 = 0.9;
    if (lit_ > 0 && node % lit_ == 0) out.lamps.push_back({0, {9, 9, 9}});
    out.absorbed_m2 = 1 - out.sky_m2;
  }
  bool isBright(uint32_t node) const { return bright_ > 0 && node > 0 && node % (kOthers / bright_) == 0; }
  uint32_t factor(uint32_t quanta) const { return factor(quanta, std::vector<SunLight>(nodes())); }
  uint32_t factor(uint32_t quanta, const std::vector<SunLight>& sun) const {
    constexpr Vec3 kGrey{0.5f, 0.5f, 0.5f};
    std::vector<ExchangeRow> rows(nodes());
    std::vector<LightValues> direct(nodes()), once(nodes()), twice(nodes());
    for (uint32_t i = 0; i < nodes(); ++i) {
      row(i, rows[i]);
      direct[i] = directLight(rows[i], 1, sun[i]);
      once[i] = reflectedLight(kGrey, 1, direct[i], rows[i], {});
    }
    for (uint32_t i = 0; i < nodes(); ++i) twice[i] = reflectedLight(kGrey, 1, direct[i], rows[i], once);
    return rowFactor(direct[0], rows[0], quanta, twice);
  }
  // With every 80th of the others in the sun of one side: they bring node 0 about kDayDark.
  uint32_t factorInStripes(uint32_t quanta) const {
    std::vector<SunLight> sun(nodes());
    for (uint32_t j = 80; j <= kOthers; j += 80) sun[j][2] = 3;
    return factor(quanta, sun);
  }
  // Standard deviation of the skylight that node 0 gets, over 1024 offsets, of its mean.
  double error(uint32_t quanta) const {
    ExchangeRow own;
    row(0, own);
    SampledRow sampled;
    double sum = 0, squares = 0;
    constexpr int kTimes = 1024;
    for (int t = 0; t < kTimes; ++t) {
      sampleRow(own, 1, quanta, (t + 0.5) / kTimes, sampled);
      double light = 0;
      for (size_t k = 0; k < sampled.column.size(); ++k)
        if (isBright(sampled.column[k])) light += sampled.count[k];
      sum += light / kTimes;
      squares += light * light / kTimes;
    }
    return std::sqrt(std::max(0.0, squares - sum * sum)) / sum;
  }

 private:
  uint32_t bright_, lit_;
};

TEST(RowSamples, AreAsManyAsTheRowsErrorAsksFor) {
  for (const uint32_t bright : {2000u, 400u, 200u, 100u, 50u}) {
    const OneRow level(bright, 0);
    const uint32_t factor = level.factor(512);
    // A dim row may err by more: by kDayRowError of kDayDark as well.
    const double light = 0.5 * 0.9 * bright / OneRow::kOthers, bound = kDayRowError * (1 + kDayDark / light);
    if (factor < formats::kMaxRowFactor) {
      EXPECT_LE(level.error(512 * factor), 1.5 * bound) << bright;
    }
    if (factor > 1) {
      EXPECT_GT(level.error(512 * factor / 2), bound / 1.5) << bright;
    }
  }
  EXPECT_EQ(OneRow(4000, 0).factor(512), 1u);
  EXPECT_GE(OneRow(20, 0).factor(512), 4u);
}

TEST(RowSamples, LampsAreALightAsWell) {
  EXPECT_EQ(OneRow(4000, 1).factor(512), 1u);
  EXPECT_GE(OneRow(4000, 500).factor(512), 4u);
}

TEST(RowSamples, StripesOfSunAskForMoreInTheDarkButNotInTheOpen) {
  EXPECT_GE(OneRow(0, 0).factorInStripes(512), 2u);
  EXPECT_EQ(OneRow(4000, 0).factorInStripes(512), 1u);
}

// A wall that faces +x, 4 m behind slats as deep as they are apart, under a roof.
Scene wallBehindBlinds() {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0, -1}, {0, 3, -1}, {0, 3, 1}, {0, 0, 1}, m);
  addQuad(s, {0, 3, -40}, {4.2f, 3, -40}, {4.2f, 3, 40}, {0, 3, 40}, m);
  for (int i = 0; i <= 15; ++i) {
    const float y = 0.2f * static_cast<float>(i);
    addQuad(s, {4, y, -40}, {4, y, 40}, {4.2f, y, 40}, {4.2f, y, -40}, m);
  }
  return s;
}

TEST(SunOnPatches, ComesInBetweenTheSlatsOfBlinds) {
  const Scene scene = wallBehindBlinds();
  const auto set = makePatches(scene, {.cell_m = 0.5f});
  const auto caster = RayCaster::create(scene);
  // The first made-up sun rises by 0.614 m a metre: it lights 0.174 m of the wall's lowest half metre.
  constexpr uint64_t kSeeds = 16;
  double sum = 0;
  int patches = 0;
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const auto sun = sunOnPatches(scene, *set, *caster, seed);
    for (size_t p = 0; p < sun.size(); ++p) {
      const Vec3& at = set->patches[p].centroid;
      if (at.x < 0.1f && at.y < 0.5f) sum += static_cast<double>(sun[p][0]), ++patches;
    }
  }
  EXPECT_EQ(patches, 4 * kSeeds);
  EXPECT_NEAR(sum / patches, 3.5 * 0.8138 * 0.174 / 0.5, 0.15);  // its deviation is 0.06
}

TEST(SunOnPatches, TheBrightestDirectionalLightOfTheFileIsOneOfThem) {
  Scene scene = wallBehindBlinds();
  const auto set = makePatches(scene, {.cell_m = 0.5f});
  const auto caster = RayCaster::create(scene);
  const auto mostOnTheWall = [&] {
    const auto sun = sunOnPatches(scene, *set, *caster, 1);
    float most = 0;
    for (size_t p = 0; p < sun.size(); ++p)
      if (set->patches[p].centroid.x < 0.1f) most = std::max(most, sun[p].back());
    return most;
  };
  EXPECT_EQ(mostOnTheWall(), 0);
  scene.lights = {{"lamp", formats::Light::kPoint, {1000, 1000, 1000}, {1, 1, 0}, {}, 0, 0, 0},
                  {"sun", formats::Light::kDirectional, {3, 3, 3}, {}, {-1, 0, 0}, 0, 0, 0},
                  {"moon", formats::Light::kDirectional, {1, 1, 1}, {}, {0, -1, 0}, 0, 0, 0}};
  EXPECT_FLOAT_EQ(mostOnTheWall(), 3.5f);
}

}  // namespace
}  // namespace ff::bake::test
