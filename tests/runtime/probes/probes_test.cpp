#include "runtime/probes/probes.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <numbers>

#include "bake/bake.h"
#include "bake/import/gltf_import.h"
#include "formats/read/whole_world.h"
#include "runtime/probes/facet_scene.h"
#include "tests/runtime/probes/radiance_oracle.h"
#include "tests/support/analytic_scenes.h"
#include "tests/support/counted_memory.h"
#include "tests/support/random_world.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace ff::runtime {
namespace {

constexpr Sky kSky{{1.1f, 1.4f, 1.9f}, {{0, 0.4f, 0}, {0, 0.5f, 0}, {0, 0.7f, 0}}};
const Vec3 kToSun = normalized({0.4f, 0.8f, 0.3f});
constexpr Vec3 kSun{13.0f, 11.8f, 9.6f};

class Folder {
 public:
  Folder() : path_(std::filesystem::temp_directory_path() / ("ff_probes_" + std::to_string(getpid()))) {
    std::filesystem::create_directories(path_);
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  std::string file(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

formats::WholeWorld baked(const bake::Scene& scene, float cell_m, const std::string& path, uint32_t rays = 256) {
  const auto stats = bake::bakeWorld(scene, {.cell_m = cell_m, .rays = rays, .quanta = 256}, path);
  if (!stats) throw std::runtime_error(stats.error().line());
  auto world = formats::WholeWorld::open(path);
  if (!world) throw std::runtime_error(world.error().line());
  return std::move(*world);
}

// Made once: baking is the slow part.
const formats::WholeWorld& town() {
  static const Folder folder;
  static const formats::WholeWorld world = [] {
    const auto made = tools::makeTown({.patches = 6000, .seed = 3});
    if (!made || !tools::writeGlb(tools::townModel(*made, false), folder.file("town.glb")))
      throw std::runtime_error("no town");
    return baked(*bake::importGltf(folder.file("town.glb")), 1, folder.file("town.ffm"));
  }();
  return world;
}
const RadianceOracle& townLight() {
  static const RadianceOracle oracle(town(), kSky, kToSun, kSun);
  return oracle;
}

// A frame's worth of runtime at a place, settled, with probes that follow it.
struct Frame {
  Frame(const formats::WholeWorld& of, std::span<const Vec3> sun_on_patches, const Sky& with_sky, ProbeSettings settings = {},
        float radius_m = 8)
      : world(of),
        sky(with_sky),
        sun(aggregateUp(of, *patchAreas(of), sun_on_patches)),
        streamer(std::move(*stream::Streamer::create(of, {.radius_m = radius_m, .hysteresis = 1}))),
        solver(makeCpuGather(2)),
        updater(of, *streamer, *solver),
        probes(of, slots, settings) {
    EXPECT_TRUE(updater.setSky(sky));
    updater.setDirectLight([this](formats::TileId id, std::span<Vec3> out) {
      const auto values = sun.tile(world, id);
      std::copy(values.begin(), values.end(), out.begin());
    });
  }
  void goTo(Vec3 at) {
    EXPECT_TRUE(updater.frame(at, {}, 1));
    EXPECT_TRUE(streamer->settle());
    EXPECT_TRUE(updater.frame(at, {}, 1));
    EXPECT_TRUE(updater.converge(1e-6f, 500));
    radiosity.resize(updater.matrix().slots());
    EXPECT_TRUE(updater.radiosity(radiosity));
    slots.follow(updater.matrix().tiles);
    tiles.clear();
    for (size_t t = 0; t < updater.matrix().tiles.size(); ++t)
      tiles.push_back({updater.matrix().tiles[t].id, updater.matrix().tiles[t].first_slot, streamer->active()[t]->nodes});
    probes.follow(stream::Observer{at, {}}, tiles, updater.matrix().leaf, ++cut);
    probes.settle();
  }
  Vec3 sample(Vec3 point, Vec3 normal) {
    Vec3 irradiance;
    probes.sample({&point, 1}, {&normal, 1}, radiosity, sky, {&irradiance, 1});
    return irradiance;
  }

  const formats::WholeWorld& world;
  const Sky sky;
  NodeValues sun;
  std::unique_ptr<stream::Streamer> streamer;
  std::unique_ptr<Solver> solver;
  Updater updater;
  SlotMap slots;
  Probes probes;
  std::vector<ProbeTile> tiles;
  std::vector<Vec4> radiosity;
  uint64_t cut = 0;
};

struct Place {
  Vec3 point, normal;
};

class Places {
 public:
  explicit Places(const RadianceOracle& oracle, uint64_t seed) : oracle_(oracle), random_(seed) {}
  float uniform() { return static_cast<float>(random_() >> 40) * 0x1p-24f; }
  // In the open air or in a room, not inside a solid; `reach` m around a point, any normal.
  Place near(Vec3 at, float reach) {
    for (int tries = 0;; ++tries) {
      if (tries == 10000) throw std::runtime_error("nothing but solids");
      const Vec3 p = at + Vec3{uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f} * (2 * reach);
      const Vec3 n = normalized({uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f});
      if (inAir(p, n)) return {p, n};
    }
  }
  Vec3 observer(const Box& bounds, bool indoors = false) {
    for (int tries = 0;; ++tries) {
      if (tries == 100000) throw std::runtime_error("no such place");
      const Vec3 p = bounds.lo + Vec3{uniform(), uniform(), uniform()} * (bounds.hi - bounds.lo);
      if (inAir(p, {0, 1, 0}) && oracle_.at(p, {0, -1, 0}, 200, 1).sky < 0.3 &&
          (!indoors || oracle_.at(p, {0, 1, 0}, 200, 1).sky < 0.02))
        return p;
    }
  }

 private:
  bool inAir(Vec3 p, Vec3 n) const {
    return oracle_.at(p, n, 200, 1).back_faces == 0 && oracle_.at(p, -1.0f * n, 200, 1).back_faces == 0;
  }
  const RadianceOracle& oracle_;
  std::mt19937_64 random_;
};

// Squared errors against the oracle, beside those that as many rays drawn at random would have by chance.
struct Errors {
  double error = 0, truth = 0, by_chance = 0, noise = 0;
  int places = 0, indoors = 0;
  void add(Vec3 got, const RadianceOracle::Irradiance& truth_there, int rays, int truth_rays) {
    for (int c = 0; c < 3; ++c) {
      const double e = static_cast<double>(got[c]) - truth_there.value[c], d = truth_there.deviation[c];
      error += e * e;
      truth += truth_there.value[c] * truth_there.value[c];
      by_chance += d * d / rays;
      noise += d * d / truth_rays;
    }
    ++places;
    indoors += truth_there.sky < 0.02;
  }
};

Errors errorsInTown(const ProbeSettings& settings, int observers) {
  Frame frame(town(), townLight().sun(), kSky, settings);
  Places places(townLight(), 9);
  Errors errors;
  for (int o = 0; o < observers; ++o) {
    const Vec3 at = places.observer(town().info().bounds, o % 2 == 1);
    frame.goTo(at);
    for (int i = 0; i < 10; ++i) {
      const Place place = places.near(at, 3);
      errors.add(frame.sample(place.point, place.normal), townLight().at(place.point, place.normal, 8192, 77),
                 static_cast<int>(settings.rays), 8192);
    }
  }
  return errors;
}

TEST(FacetScenes, GoOnWithWhatTheyHaveWhileMemoryIsLacking) {
  const formats::TemporaryFolder folder;
  ASSERT_TRUE(formats::writeWorld(formats::makeRandomWorld({}), folder.file("w.ffm"), 1 << 20));
  const auto world = formats::WholeWorld::open(folder.file("w.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  FacetScenes scenes(*world, 1 << 26);
  refuseOthersEveryNth(1);
  scenes.moveTo(stream::Observers());
  scenes.settle();
  refuseOthersEveryNth(0);
  EXPECT_TRUE(scenes.starved());
  EXPECT_EQ(scenes.tiles(), 0u);
  scenes.moveTo(stream::Observer{{1000, 0, 0}, {}});
  scenes.settle();
  EXPECT_EQ(scenes.tiles(), world->tiles(0).size());
}

// The oracle finds patches with Embree and knows every patch's radiosity; the probes meet triangles by their own trees,
// on patches near the observer and on clusters' slots beyond. Stratified rays err no more than as many drawn at random; the
// cut adds under 1 % of the light (DESIGN.md, section 2), the oracle its own noise.
TEST(Probes, AgreeWithRaysCastFromThePointInAndOutOfDoors) {
  const Errors e = errorsInTown({.rays = 256}, 12);
  RecordProperty("relative_l2", std::to_string(std::sqrt(e.error / e.truth)));
  std::printf("probes in a town: relative L2 %.4f, by chance %.4f (%d places, %d indoors)\n", std::sqrt(e.error / e.truth),
              std::sqrt(e.by_chance / e.truth), e.places, e.indoors);
  EXPECT_LT(e.error, e.by_chance + e.noise + 1e-4 * e.truth);
  EXPECT_GT(e.indoors, 20);
  EXPECT_GT(e.places - e.indoors, 20);
}

// Four times the rays: half of what chance leaves, or less.
TEST(Probes, ErrLessWithMoreRays) {
  const Errors few = errorsInTown({.rays = 64}, 6), many = errorsInTown({.rays = 1024}, 6);
  EXPECT_LT(many.error, many.by_chance + many.noise + 1e-4 * many.truth);
  EXPECT_LT(many.error, 0.25 * few.error);
}

// A world of axis-aligned unit faces is what planes in cells can stand for exactly; clusters' holes are guessed. Worlds
// baked without drawing geometry, and what is past the budget of triangles, have nothing else.
TEST(Probes, PlanesOfTheCutStandInWhereNoTrianglesAreLoaded) {
  const Errors e = errorsInTown({.rays = 256, .facet_bytes = 0}, 12);
  std::printf("probes that meet planes: relative L2 %.4f, by chance %.4f\n", std::sqrt(e.error / e.truth),
              std::sqrt(e.by_chance / e.truth));
  EXPECT_LT(e.error, e.by_chance + e.noise + 4e-3 * e.truth);  // 6 % for guessed holes
}

// In a closed room of one radiosity, every ray carries it: the irradiance is exactly that, whatever the point and normal.
TEST(Probes, AFurnaceGivesItsRadiosityToEveryPointAndNormal) {
  const Folder folder;
  const formats::WholeWorld world = baked(bake::test::closedBox({.5f, .5f, .5f}, {1, 2, 3}), 0.125f, folder.file("box.ffm"));
  for (const uint64_t facet_bytes : {uint64_t{1} << 24, uint64_t{0}}) {
    Frame frame(world, std::vector<Vec3>(world.levels()[0].nodes), {}, {.facet_bytes = facet_bytes}, 1);
    frame.goTo({0.5f, 0.5f, 0.5f});
    std::mt19937_64 random(4);
    const auto uniform = [&] { return static_cast<float>(random() >> 40) * 0x1p-24f; };
    for (int i = 0; i < 100; ++i) {
      const Vec3 p = Vec3{0.01f, 0.01f, 0.01f} + 0.98f * Vec3{uniform(), uniform(), uniform()};
      const Vec3 e = frame.sample(p, normalized({uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f}));
      // M / (1 - rho). Rows close exactly, but lamps' light is what the bake's rays found: off by what a row's total is off, d at
      // most, so that B is by rho d M / (1 - rho) = d M. Converged to 1e-6 of the largest change, albedo stored in 16 bits.
      const float d = world.info().row_total_deviation;
      ASSERT_LT(d, 0.1f);
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(e[c], 3.14159265f * static_cast<float>(c + 1) / 0.5f, (d + 1e-4f) * 3.14159265f * static_cast<float>(c + 1));
    }
  }
}

TEST(Probes, TheOpenSkyGivesItsClosedForm) {
  const Folder folder;
  bake::Scene scene;
  const uint32_t m = bake::test::addMaterial(scene, {.5f, .5f, .5f});
  bake::test::addQuad(scene, {0, 0, 0}, {0, 0, 4}, {4, 0, 4}, {4, 0, 0}, m);
  const formats::WholeWorld world = baked(scene, 0.5f, folder.file("floor.ffm"));
  Frame frame(world, std::vector<Vec3>(world.levels()[0].nodes), kSky, {.rays = 1024});
  frame.goTo({2, 1, 2});
  // The cosine-weighted mean direction around n is 2/3 n; stratified over 1024 rays it is exact to about 1e-3.
  const Vec3 up = frame.sample({2, 1, 2}, {0, 1, 0});
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(up[c], 3.14159265f * (kSky.l0[c] + kSky.l1[c].y * 2 / 3), 3e-3f * up[c]);
  // Downwards, in the middle over the floor at height h: the form factor to the square from a point (Howell. A Catalog of
  // Radiation Heat Transfer Configuration Factors. B-3, four times) times the radiosity, which is that of a floor under
  // an open sky.
  const float h = 0.5f, x = 2 / h;
  const float factor = 4 / (2 * 3.14159265f) * 2 * (x / std::sqrt(1 + x * x) * std::atan(x / std::sqrt(1 + x * x)));
  const Vec3 down = frame.sample({2, h, 2}, {0, -1, 0});
  for (int c = 0; c < 3; ++c) {
    const float floor = 0.5f * 3.14159265f * (kSky.l0[c] + kSky.l1[c].y * 2 / 3);
    // What passes the floor's edges comes from the sky below the horizon: within its smallest and largest radiance.
    const float most = 3.14159265f * (1 - factor) * kSky.l0[c], least = 3.14159265f * (1 - factor) * (kSky.l0[c] - kSky.l1[c].y);
    EXPECT_GT(down[c], factor * floor * 0.98f + least * 0.9f);
    EXPECT_LT(down[c], factor * floor * 1.02f + most * 1.1f);
  }
}

// A street in sun and sky; beside it, behind a wall of 20 cm, a room without a window or a lamp. Triangles or planes:
// nothing comes through.
TEST(Probes, ADarkRoomBesideALitStreetStaysDark) {
  const Folder folder;
  bake::Scene scene;
  const uint32_t m = bake::test::addMaterial(scene, {.7f, .7f, .7f});
  const auto box = [&](Vec3 lo, Vec3 hi, bool inward) {
    const auto quad = [&](Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
      inward ? bake::test::addQuad(scene, a, b, c, d, m) : bake::test::addQuad(scene, a, d, c, b, m);
    };
    quad({lo.x, lo.y, lo.z}, {lo.x, lo.y, hi.z}, {hi.x, lo.y, hi.z}, {hi.x, lo.y, lo.z});
    quad({lo.x, hi.y, lo.z}, {hi.x, hi.y, lo.z}, {hi.x, hi.y, hi.z}, {lo.x, hi.y, hi.z});
    quad({lo.x, lo.y, lo.z}, {lo.x, hi.y, lo.z}, {lo.x, hi.y, hi.z}, {lo.x, lo.y, hi.z});
    quad({hi.x, lo.y, lo.z}, {hi.x, lo.y, hi.z}, {hi.x, hi.y, hi.z}, {hi.x, hi.y, lo.z});
    quad({lo.x, lo.y, lo.z}, {hi.x, lo.y, lo.z}, {hi.x, hi.y, lo.z}, {lo.x, hi.y, lo.z});
    quad({lo.x, lo.y, hi.z}, {lo.x, hi.y, hi.z}, {hi.x, hi.y, hi.z}, {hi.x, lo.y, hi.z});
  };
  box({0, 0, 0}, {6, 3, 6}, true);                                                   // the room
  box({-0.2f, -0.2f, -0.2f}, {6.2f, 3.2f, 6.2f}, false);                             // the house around it
  bake::test::addQuad(scene, {6.2f, -0.2f, -20}, {6.2f, -0.2f, 20}, {30, -0.2f, 20}, {30, -0.2f, -20}, m);  // the street
  const formats::WholeWorld world = baked(scene, 0.5f, folder.file("house.ffm"));
  const RadianceOracle oracle(world, kSky, kToSun, kSun);
  for (const uint64_t facet_bytes : {uint64_t{1} << 24, uint64_t{0}}) {
    Frame frame(world, oracle.sun(), kSky, {.facet_bytes = facet_bytes}, 6);
    frame.goTo({5, 1.5f, 3});
    std::mt19937_64 random(6);
    const auto uniform = [&] { return static_cast<float>(random() >> 40) * 0x1p-24f; };
    for (int i = 0; i < 200; ++i) {
      const Vec3 normal = normalized({uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f});
      const Vec3 inside{0.01f + 5.98f * uniform(), 0.01f + 2.98f * uniform(), 0.01f + 5.98f * uniform()};
      ASSERT_EQ(frame.sample(inside, normal), Vec3{});
      ASSERT_GT(frame.sample({7 + 4 * uniform(), 0.5f, 6 * uniform()}, {-1, 0, 0}).y, 1.0f);
    }
  }
}

// A solid block around `at`, of half extents x, y, z (right-handed).
void addBlock(bake::Scene& scene, Vec3 at, Vec3 x, Vec3 y, Vec3 z, uint32_t material) {
  const auto sides = [&](Vec3 u, Vec3 v, Vec3 out) {  // u, v, out right-handed
    bake::test::addQuad(scene, at + out - u - v, at + out + u - v, at + out + u + v, at + out - u + v, material);
    bake::test::addQuad(scene, at - out - u - v, at - out - u + v, at - out + u + v, at - out + u - v, material);
  };
  sides(x, y, z);
  sides(y, z, x);
  sides(z, x, y);
}

// A hall with one bright wall and slanted boards all over: cells hold many surfaces, none of which fills its plane. Here
// the triangles are needed; planes err several times as much.
TEST(Probes, MeetTrianglesWhereCellsHoldSlantedSurfaces) {
  const Folder folder;
  bake::Scene scene = bake::test::closedBox({.6f, .6f, .6f}, {});
  for (Vec3& p : scene.positions) p = p * 8.0f;
  const uint32_t bright = bake::test::addMaterial(scene, {.5f, .5f, .5f}, {5, 4, 3}), board = bake::test::addMaterial(scene, {.3f, .6f, .2f});
  for (size_t t = 4; t < 6; ++t) scene.triangles[t].material = bright;
  std::mt19937_64 random(8);
  const auto uniform = [&] { return static_cast<float>(random() >> 40) * 0x1p-24f; };
  for (int i = 0; i < 60; ++i) {
    const Vec3 at = Vec3{1.2f, 1.2f, 1.2f} + 5.6f * Vec3{uniform(), uniform(), uniform()};
    const Vec3 x = normalized({uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f});
    const Vec3 y = normalized(cross(x, {uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f}));
    addBlock(scene, at, x, y * 0.3f, normalized(cross(x, y)) * 0.03f, board);
  }
  const formats::WholeWorld world = baked(scene, 0.5f, folder.file("boards.ffm"));
  const RadianceOracle oracle(world, {}, kToSun, {});
  double relative[2];
  for (const bool planes : {false, true}) {
    Frame frame(world, oracle.sun(), {}, {.rays = 256, .facet_bytes = planes ? 0u : 1u << 24}, 3);
    frame.goTo({4, 4, 4});
    Places places(oracle, 5);
    Errors e;
    for (int i = 0; i < 100; ++i) {
      const Place place = places.near({4, 4, 4}, 3);
      e.add(frame.sample(place.point, place.normal), oracle.at(place.point, place.normal, 8192, 3), 256, 8192);
    }
    relative[planes] = std::sqrt(e.error / e.truth);
    if (!planes) {
      EXPECT_LT(e.error, e.by_chance + e.noise + 1e-4 * e.truth);
    }
  }
  std::printf("probes among slanted boards: relative L2 %.4f by triangles, %.4f by planes\n", relative[0], relative[1]);
  EXPECT_LT(relative[0], 0.5 * relative[1]);
}

// Irradiance from a quad of radiosity 1, all of it in front of the point. Johann Heinrich Lambert. Photometria. 1760.
double lambert(Vec3 point, Vec3 normal, const std::array<Vec3, 4>& corners) {
  double sum = 0;
  for (size_t i = 0; i < 4; ++i) {
    const Vec3 a = normalized(corners[i] - point), b = normalized(corners[(i + 1) % 4] - point), across = cross(a, b);
    sum += std::atan2(static_cast<double>(length(across)), static_cast<double>(dot(a, b))) * static_cast<double>(dot(normalized(across), normal));
  }
  return std::abs(sum) / (2 * std::numbers::pi);
}

// Of 256 rays none or one finds it.
TEST(Probes, ASmallLampInABlackHallGivesItsClosedForm) {
  const Folder folder;
  bake::Scene scene;
  const uint32_t black = bake::test::addMaterial(scene, {}), bright = bake::test::addMaterial(scene, {}, {1000, 500, 250});
  bake::test::addRoom(scene, {0, 0, 0}, {16, 6, 16}, black, black);
  const std::array<Vec3, 4> lamp{Vec3{8.15f, 5.95f, 8.15f}, {8.35f, 5.95f, 8.15f}, {8.35f, 5.95f, 8.35f}, {8.15f, 5.95f, 8.35f}};  // seen from below
  bake::test::addQuad(scene, lamp[0], lamp[1], lamp[2], lamp[3], bright);
  const formats::WholeWorld world = baked(scene, 1, folder.file("hall.ffm"));
  const std::vector<Vec3> no_sun(world.levels()[0].nodes);
  std::mt19937_64 random(4);
  const auto uniform = [&] { return static_cast<float>(random() >> 40) * 0x1p-24f; };
  double without = 0;
  int places = 0;
  Frame frame(world, no_sun, {}), plain(world, no_sun, {}, {.max_lamps = 0});
  frame.goTo({8, 2, 8});
  plain.goTo({8, 2, 8});
  while (places < 200) {
    const Vec3 point{8 + 8 * (uniform() - 0.5f), 0.1f + 5.6f * uniform(), 8 + 8 * (uniform() - 0.5f)}, normal = normalized({uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f});
    if (!std::ranges::all_of(lamp, [&](Vec3 corner) { return dot(normal, normalized(corner - point)) > 0.02f; })) continue;
    const double truth = 1000 * std::numbers::pi * lambert(point, normal, lamp);
    const Vec3 got = frame.sample(point, normal);
    const bool close = length(lamp[0] - point) < 1;  // where own rays find it, too
    EXPECT_NEAR(static_cast<double>(got.x) / truth, 1, close ? 0.06 : 0.02) << point.x << " " << point.y << " " << point.z << ", " << truth;
    EXPECT_NEAR(got.z / got.x, 0.25f, 1e-3f);
    without += std::abs(static_cast<double>(plain.sample(point, normal).x) / truth - 1) / 200;
    ++places;
  }
  EXPECT_GT(without, 0.5);
}

// A panel of nine patches over a table, at any distance: beside a probe that leaves it to chance, with so many rays that this is small.
TEST(Probes, ALampOfManyPatchesAndItsShadowsAreThoseOfManyRays) {
  const Folder folder;
  bake::Scene scene;
  const uint32_t grey = bake::test::addMaterial(scene, {.5f, .5f, .5f}), bright = bake::test::addMaterial(scene, {}, {10, 10, 10});
  bake::test::addRoom(scene, {0, 0, 0}, {4, 3, 5}, grey, grey);
  bake::test::addBlock(scene, {2.4f, 0, 2.5f}, {3.2f, 0.8f, 3.7f}, grey);
  bake::test::addQuad(scene, {1.2f, 2.99f, 1.3f}, {1.8f, 2.99f, 1.3f}, {1.8f, 2.99f, 1.9f}, {1.2f, 2.99f, 1.9f}, bright);
  const formats::WholeWorld world = baked(scene, 0.2f, folder.file("room.ffm"));
  const std::vector<Vec3> no_sun(world.levels()[0].nodes);
  Frame frame(world, no_sun, {}), plain(world, no_sun, {}, {.max_lamps = 0}), many(world, no_sun, {}, {.rays = 65535, .max_lamps = 0, .max_kept = 8});
  for (Frame* f : {&frame, &plain, &many}) f->goTo({2, 1.5f, 2});
  std::mt19937_64 random(5);
  const auto uniform = [&] { return static_cast<float>(random() >> 40) * 0x1p-24f; };
  double error = 0, without = 0, all = 0;
  for (int i = 0; i < 60; ++i) {
    const bool close = i % 6 == 0;  // to the lamp
    const Vec3 point = close ? Vec3{1.1f + 0.8f * uniform(), 2.8f + 0.15f * uniform(), 1.2f + 0.8f * uniform()} : Vec3{0.1f + 2.2f * uniform(), 0.05f + 2.8f * uniform(), 0.1f + 4.8f * uniform()};
    const Vec3 normal = normalized({uniform() - 0.5f, uniform() - 0.5f, uniform() - 0.5f});
    const double truth = static_cast<double>(many.sample(point, normal).x), weight = close ? 0.01 : 1;  // next to a lamp it is a hundred times as bright
    const auto square = [&](Frame& f) { return weight * std::pow(static_cast<double>(f.sample(point, normal).x) - truth, 2); };
    error += square(frame);
    without += square(plain);
    all += weight * truth * truth;
  }
  std::printf("probes in a room with a lamp: relative L2 %.4f, by 256 rays alone %.4f\n", std::sqrt(error / all), std::sqrt(without / all));
  EXPECT_LT(error, 0.03 * 0.03 * all);
  EXPECT_GT(without, 0.07 * 0.07 * all);
}

TEST(Probes, KeptProbesFollowTheLightWithoutNewRays) {
  Frame frame(town(), townLight().sun(), kSky);
  Places places(townLight(), 2);
  const Vec3 at = places.observer(town().info().bounds);
  frame.goTo(at);
  const Place place = places.near(at, 2);
  const Vec3 before = frame.sample(place.point, place.normal);
  const uint64_t traced = frame.probes.stats().traced;
  for (Vec4& b : frame.radiosity) b = {2 * b.x, 2 * b.y, 2 * b.z, 0};
  Vec3 after;
  const Sky brighter{2.0f * kSky.l0, {2.0f * kSky.l1[0], 2.0f * kSky.l1[1], 2.0f * kSky.l1[2]}};
  frame.probes.sample({&place.point, 1}, {&place.normal, 1}, frame.radiosity, brighter, {&after, 1});
  EXPECT_EQ(frame.probes.stats().traced, traced);
  EXPECT_EQ(after, 2.0f * before);
}

// Also right after a change of the cut, before a kept probe's turn for new rays has come.
TEST(Probes, AWalkLeavesNoTraceInTheAnswers) {
  Frame wandering(town(), townLight().sun(), kSky, {.rays = 64}), lazy(town(), townLight().sun(), kSky, {.rays = 64, .max_refreshed = 0});
  Places places(townLight(), 11);
  const Vec3 home = places.observer(town().info().bounds);
  std::vector<Place> probes;
  for (int i = 0; i < 16; ++i) probes.push_back(places.near(home, 3));
  double difference = 0, sum = 0;
  for (int step = 0; step < 6; ++step) {
    const Vec3 at = step % 2 ? places.near(home, 6).point : home;
    wandering.goTo(at);
    lazy.goTo(at);
    Frame fresh(town(), townLight().sun(), kSky, {.rays = 64});
    fresh.goTo(at);
    for (const Place& p : probes) {
      const Vec3 truth = fresh.sample(p.point, p.normal), got = wandering.sample(p.point, p.normal);
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(got[c], truth[c], 1e-4f * (1 + truth[c]));
      difference += static_cast<double>(length(lazy.sample(p.point, p.normal) - truth));
      sum += static_cast<double>(length(truth));
    }
  }
  // Old rays on a new cut: the same surfaces, on levels that were right before.
  EXPECT_LT(difference, 0.05 * sum);
  EXPECT_GT(lazy.probes.stats().kept, 0u);
}

TEST(Probes, FollowingAndSamplingAllocateAndFreeNothing) {
  Frame frame(town(), townLight().sun(), kSky, {.rays = 64, .max_kept = 32, .facet_bytes = 1 << 20});
  Places places(townLight(), 12);
  std::vector<Place> probes;
  const Vec3 home = places.observer(town().info().bounds);
  for (int i = 0; i < 64; ++i) probes.push_back(places.near(home, 3));
  for (int step = 0; step < 12; ++step) {
    const Vec3 at = home + Vec3{static_cast<float>(step % 4) * 5 - 8, 0, static_cast<float>(step / 4) * 6 - 8};
    frame.goTo(at);
    const MemoryCalls before = memoryCalls();
    frame.probes.follow(stream::Observer{at + Vec3{5, 0, 0}, {}}, frame.tiles, frame.updater.matrix().leaf, ++frame.cut);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    frame.probes.follow(stream::Observer{at, {}}, frame.tiles, frame.updater.matrix().leaf, ++frame.cut);
    float sum = 0;
    for (const Place& p : probes) sum += frame.sample(p.point, p.normal).y;
    const MemoryCalls after = memoryCalls();
    EXPECT_EQ(after.allocated - before.allocated, 0u);
    EXPECT_EQ(after.freed - before.freed, 0u);
    EXPECT_GT(sum, 0);
  }
  EXPECT_GT(frame.probes.stats().facet_tiles, 0u);
}

}  // namespace
}  // namespace ff::runtime
