// Pictures of errors: which patches are seen, from where, and in what colours.
#include "tools/chart/sweep/heat_picture.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "tests/support/analytic_scenes.h"
#include "tests/tools/chart/chart_world.h"
#include "tools/chart/scene_of_model.h"
#include "tools/chart/sweep/comparison.h"
#include "tools/chart/sweep/running_cut.h"
#include "tools/scene/analytic.h"

namespace ff::chart {
namespace {

constexpr uint32_t kRays = 256;

using HeatPicture = InABakedScene;

using Colour = std::array<int, 3>;
Colour at(const view::Picture& p, uint32_t x, uint32_t y) {
  Colour c{};
  for (size_t k = 0; k < 3; ++k) c[k] = p.rgb[3 * (size_t{y} * p.width + x) + k];
  return c;
}
int brightness(const Colour& c) { return c[0] + c[1] + c[2]; }

// Seen from above with the sky around it: left half exact, right half wrong, a patch in the middle not known.
TEST_F(HeatPicture, ColoursPatchesByTheirError) {
  bake::Scene floor;
  bake::test::addQuad(floor, {0, 0, 0}, {0, 0, 4}, {4, 0, 4}, {4, 0, 0}, bake::test::addMaterial(floor, {0.5f, 0.5f, 0.5f}));
  ASSERT_NO_FATAL_FAILURE(open(std::move(floor), 1, kRays));
  const SeenPatches seen = lookFrom(world_->tracer(), {{2, 5, 2.001f}, {2, 0, 2}}, 160, 100, 1);
  EXPECT_EQ(seen.distinct().size(), world_->patches().size());
  std::vector<float> errors;
  for (const formats::Node& n : world_->patches()) errors.push_back(n.centroid.x < 2 ? 0.0f : 0.2f);
  const view::Picture heat = heatOf(seen, errors, 0.2f, "test");
  // Is x = 1 left or right? As the directions say.
  const bool left = seen.direction[50 * 160 + 70].x < 0;
  const Colour exact = at(heat, left ? 70 : 90, 45), wrong = at(heat, left ? 90 : 70, 45), sky = at(heat, 3, 45);
  EXPECT_LT(brightness(exact), 60);
  EXPECT_GT(brightness(wrong), 600);
  EXPECT_NEAR(sky[0], sky[1], 8) << "grey";
  std::fill(errors.begin(), errors.end(), -1.0f);
  EXPECT_EQ(at(heatOf(seen, errors, 0.2f, "test"), 70, 45), sky) << "not known";

  const std::vector<Vec3> red(world_->patches().size(), {1, 0.1f, 0.1f});
  const view::Picture lit = litOf(seen, red, {{0, 0, 1}, {}});
  EXPECT_GT(at(lit, 80, 50)[0], 2 * at(lit, 80, 50)[2]);
  EXPECT_GT(at(lit, 3, 50)[2], 2 * at(lit, 3, 50)[0]) << "the sky's own colour";
  const view::Picture both = sideBySide(heat, lit);
  EXPECT_EQ(both.width, 320u);
  EXPECT_EQ(at(both, 70, 45), at(heat, 70, 45));
  EXPECT_EQ(at(both, 160 + 70, 45), at(lit, 70, 45));
}

TEST_F(HeatPicture, StandsInTheRoomAndSeesThePatch) {
  ASSERT_NO_FATAL_FAILURE(open(sceneOf(tools::twoRooms(0.5f, 0.6f, 10)), 0.5f, kRays));
  for (uint32_t p = 0; p < world_->patches().size(); p += 7) {
    const formats::Node& n = world_->patches()[p];
    const Viewpoint v = viewpointOf(*world_, p, {2, 1.5f, 2});
    const float first = n.centroid.x < 4.25f ? 0.0f : 4.5f;
    EXPECT_GT(v.eye.x, first) << p;
    EXPECT_LT(v.eye.x, first + 4) << p;
    EXPECT_GT(v.eye.y, 0) << p;
    EXPECT_LT(v.eye.y, 3) << p;
    EXPECT_EQ(world_->tracer().patchSeen(v.eye, normalized(n.centroid - v.eye)), p);
    EXPECT_GT(length(v.eye - n.centroid), 1) << p << ": a room this size leaves more than two cells";
  }
}

// A constant for all that is far is wrong where the light falls off along a corridor, more at one place than at another.
TEST_F(HeatPicture, TheWorstPlaceIsThatWithTheLargestError) {
  ASSERT_NO_FATAL_FAILURE(open(sceneOf(tools::corridor(0.7f, 10)), 0.5f, kRays));
  const std::vector<Place> places{{{2, 1, 1}, {}, 1.5f}, {{10, 1, 1}, {}, 1.5f}, {{18, 1, 1}, {}, 1.5f}};
  world_->lookAt(places, 60);
  const std::vector<Lighting> lights{{.name = "lamp", .sky = {}, .sun = {}, .lamps = 1}};
  Knobs few;
  few.radius_m = 3;
  few.pyramid = false;
  const WorstPlaces options{.most = 2, .paths = 20000};
  const auto pictures = worstPlaces(*world_, places, lights, few, {.paths = 256}, folder_.path(), options);
  ASSERT_TRUE(pictures) << pictures.error().line();
  ASSERT_EQ(pictures->size(), 2u);
  auto cut = RunningCut::create(*world_, few);
  ASSERT_TRUE(cut) << cut.error().line();
  const auto lit = world_->lit(lights[0], few.shadow_rays, nullptr);
  ASSERT_TRUE(lit) << lit.error().line();
  std::vector<std::pair<double, const char*>> ranked;
  for (size_t i = 0; i < places.size(); ++i) {
    ASSERT_TRUE(cut->moveTo(places[i].observer));
    ASSERT_TRUE(cut->setLight(**lit));
    ASSERT_TRUE(cut->settle());
    const auto got = cut->reflected(**lit, world_->patchesOf(i));
    ASSERT_TRUE(got) << got.error().line();
    Comparison comparison;
    comparison.addPlace(*world_, **lit, world_->ofPlace(i), *got);
    const char* const at[] = {"(2.0,", "(10.0,", "(18.0,"};
    ranked.emplace_back(comparison.accuracy("").rel_l2.value, at[i]);
  }
  std::sort(ranked.rbegin(), ranked.rend());
  EXPECT_GT(ranked[0].first, 1.2 * ranked[1].first) << "or their order says little";
  EXPECT_NE((*pictures)[0].note.find(ranked[0].second), std::string::npos) << (*pictures)[0].note;
  // Errors below the tracer's noise are all 0, and in no order.
  if (ranked[1].first > 0) {
    EXPECT_NE((*pictures)[1].note.find(ranked[1].second), std::string::npos) << (*pictures)[1].note;
  }
  for (const Illustration& p : *pictures) {
    EXPECT_GT(std::filesystem::file_size(folder_.file(p.file)), 1000u);
    std::ifstream file(folder_.file(p.file), std::ios::binary);
    char head[24] = {};
    file.read(head, sizeof head);
    EXPECT_EQ(std::string(head + 1, 3), "PNG");
    EXPECT_EQ(static_cast<unsigned char>(head[18]) * 256 + static_cast<unsigned char>(head[19]), 1280) << "two of 640";
  }
  const auto other = worstPlaces(*world_, std::span(places).first(1), lights, few, {.paths = 64}, folder_.path(), options);
  ASSERT_FALSE(other);
  EXPECT_EQ(other.error().code, ErrorCode::kUsage);
}

}  // namespace
}  // namespace ff::chart
