// Where a light of a few lamps is looked at.
#include "tools/chart/sweep/places.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "tests/support/analytic_scenes.h"
#include "tests/tools/chart/chart_world.h"
#include "tools/chart/sweep/comparison.h"

namespace ff::chart {
namespace {

// Two rooms of 4 x 3 x 4 m, x = 0 to 4 and 4.5 to 8.5, with a door 1 m wide between them and a lamp on each floor.
bake::Scene roomsWithADoor() {
  bake::Scene s;
  const uint32_t wall = bake::test::addMaterial(s, {0.7f, 0.7f, 0.7f}), lamp = bake::test::addMaterial(s, {}, {20, 20, 20}),
                 other_lamp = bake::test::addMaterial(s, {}, {20, 20, 20});
  const auto quad = [&](Vec3 a, Vec3 b, Vec3 c, Vec3 d, uint32_t m) { bake::test::addQuad(s, a, b, c, d, m); };
  const auto facingUp = [&](float x0, float x1, float z0, float z1, float y, uint32_t m) {
    quad({x0, y, z0}, {x0, y, z1}, {x1, y, z1}, {x1, y, z0}, m);
  };
  const auto facingRight = [&](float x, float z0, float z1) { quad({x, 0, z0}, {x, 3, z0}, {x, 3, z1}, {x, 0, z1}, wall); };
  const auto facingLeft = [&](float x, float z0, float z1) { quad({x, 0, z0}, {x, 0, z1}, {x, 3, z1}, {x, 3, z0}, wall); };
  const auto between = [&](float x0, float x1, float z0, float z1) {  // floor, ceiling and the two walls along x
    facingUp(x0, x1, z0, z1, 0, wall);
    quad({x0, 3, z0}, {x1, 3, z0}, {x1, 3, z1}, {x0, 3, z1}, wall);
    quad({x0, 0, z0}, {x1, 0, z0}, {x1, 3, z0}, {x0, 3, z0}, wall);
    quad({x0, 0, z1}, {x0, 3, z1}, {x1, 3, z1}, {x1, 0, z1}, wall);
  };
  between(0, 4, 0, 4);
  between(4.5f, 8.5f, 0, 4);
  between(4, 4.5f, 1.5f, 2.5f);  // the door
  facingRight(0, 0, 4);
  facingLeft(8.5f, 0, 4);
  for (const auto& [z0, z1] : {std::pair{0.0f, 1.5f}, {2.5f, 4.0f}}) {
    facingLeft(4, z0, z1);
    facingRight(4.5f, z0, z1);
  }
  facingUp(1.5f, 2.5f, 1.5f, 2.5f, 0.1f, lamp);
  facingUp(6.5f, 7.5f, 1.5f, 2.5f, 0.1f, other_lamp);
  return s;
}

class OneRoomLit : public InABakedScene {
 protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(open(roomsWithADoor(), 0.5f, 1024));
    SweepOptions options;
    options.lights = {{.name = "lamps", .sky = {}, .sun = {}, .lamps = 1}};
    const auto lights = lightsOf(options, *world_, std::vector<Place>{{{2, 1.5f, 2}, {}, 3}}, [](const std::string&) {});
    ASSERT_EQ(lights.size(), 2u);
    room_ = lights[1];
    standard_.bake.cell_m = 0.5f;
    standard_.radius_m = 6;
  }
  std::vector<Place> places() {
    auto found = placesInLight(room_, *world_, standard_);
    EXPECT_TRUE(found) << found.error().line();
    return found ? *found : std::vector<Place>{};
  }

  Lighting room_;
  Knobs standard_;
};

TEST_F(OneRoomLit, IsSharedOutAmongEightObserversEachWithItsOwnSurface) {
  EXPECT_EQ(room_.name, kOneGroupLit);
  const std::vector<Place> found = places();
  ASSERT_EQ(found.size(), 8u);
  const auto lit = world_->lit(room_, standard_.shadow_rays, nullptr);
  ASSERT_TRUE(lit) << lit.error().line();
  std::vector<double> shares(found.size(), 0);
  double all = 0;
  bool beyond_the_door = false;
  for (size_t p = 0; p < world_->patches().size(); ++p) {
    const formats::Node& node = world_->patches()[p];
    double b = 0;
    for (size_t c = 0; c < 3; ++c) b += (*lit)->full[3 * p + c];
    const double share = static_cast<double>(node.area_m2) * b * b;
    all += share;
    int boxes = 0;
    for (size_t at = 0; at < found.size(); ++at) {
      if (found[at].within.distance(node.centroid) > 0) continue;
      ++boxes;
      shares[at] += share;
      if (node.centroid.x > 4.4f) beyond_the_door = true;
    }
    EXPECT_LE(boxes, 1) << "counted twice: patch " << p;
  }
  for (size_t at = 0; at < found.size(); ++at) {
    EXPECT_GT(shares[at], all / 24) << at;
    EXPECT_LT(shares[at], all / 4) << at;
    EXPECT_EQ(found[at].in_light, kOneGroupLit);
    EXPECT_GT(found[at].reach_m, 0);
    const Vec3 eye = found[at].observer;
    EXPECT_TRUE(eye.x > 0 && eye.x < 8.5f && eye.y > 0 && eye.y < 3 && eye.z > 0 && eye.z < 4) << at;
  }
  EXPECT_TRUE(beyond_the_door) << "what falls through it is in";
  EXPECT_GT(std::accumulate(shares.begin(), shares.end(), 0.0), 0.9 * all);
}

TEST_F(OneRoomLit, HasAnErrorThatIsKnown) {
  const std::vector<Place> found = places();
  world_->lookAt(found, 1000);
  const TraceSettings trace{.paths = 1024};
  const auto lit = world_->lit(room_, standard_.shadow_rays, &trace);
  ASSERT_TRUE(lit) << lit.error().line();
  Comparison comparison;
  for (size_t at = 0; at < found.size(); ++at) {
    std::vector<double> full;
    for (const uint32_t p : world_->patchesOf(at))
      for (size_t c = 0; c < 3; ++c) full.push_back((*lit)->full[3 * size_t{p} + c]);
    comparison.addPlace(*world_, **lit, world_->ofPlace(at), full);
  }
  const Figure error = comparison.accuracy("").rel_l2;
  EXPECT_GT(error.value, 0);
  EXPECT_GT(error.error, 0);
  EXPECT_LT(error.error, 0.01);  // the error itself may be less
}

TEST_F(OneRoomLit, IsLookedAtFromTheSamePlacesEachTime) {
  const std::vector<Place> once = places(), again = places();
  ASSERT_EQ(once.size(), again.size());
  for (size_t at = 0; at < once.size(); ++at) {
    EXPECT_EQ(once[at].observer, again[at].observer);
    EXPECT_EQ(once[at].reach_m, again[at].reach_m);
    EXPECT_EQ(once[at].within.lo, again[at].within.lo);
  }
}

TEST_F(OneRoomLit, HasNoPlacesWhereNothingShines) {
  room_.name = "dark";
  room_.lamps = 0;
  EXPECT_TRUE(places().empty());
}

TEST_F(OneRoomLit, IsLookedAtFromItsOwnPlacesAloneAndTheOthersFromTheirs) {
  std::vector<Place> all(3);
  all[2].in_light = kOneGroupLit;
  Lighting lamps;
  lamps.name = "lamps";
  for (size_t at = 0; at < all.size(); ++at) {
    EXPECT_EQ(isSeen(all, at, room_), at == 2);
    EXPECT_EQ(isSeen(all, at, lamps), at != 2);
  }
  all.pop_back();
  EXPECT_TRUE(isSeen(all, 0, room_)) << "no places of its own";
}

// A box between the patches of a coarser bake: the nearest one stands for it.
TEST_F(OneRoomLit, ABoxWithoutPatchesLooksAtTheNearest) {
  Place place{{2, 1.5f, 0.2f}, {}, 3};
  place.within = {{2, 1.5f, 0.1f}, {2, 1.5f, 0.1f}};
  world_->lookAt(std::span(&place, 1), 10);
  const std::vector<uint32_t> patches = world_->patchesOf(0);
  ASSERT_EQ(patches.size(), 1u);
  const auto away = [&](const formats::Node& n) { return length(n.centroid - place.observer); };
  for (const formats::Node& n : world_->patches()) EXPECT_GE(away(n), away(world_->patches()[patches[0]]));
  place.reach_m = 0.01f;
  world_->lookAt(std::span(&place, 1), 10);
  EXPECT_TRUE(world_->patchesOf(0).empty()) << "out of reach";
}

}  // namespace
}  // namespace ff::chart
