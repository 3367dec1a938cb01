// The path tracer against light that is known in closed form. Where a tolerance is a number of standard errors, it is
// that of a mean of many patches, whose error is nearly normal: four of them are passed by chance once in 16,000 runs,
// and every run draws the same numbers.
#include "tools/chart/truth/path_tracer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <numbers>
#include <numeric>

#include "bake/bake.h"
#include "formats/read/whole_world.h"
#include "tests/support/analytic_scenes.h"
#include "tools/chart/scene_of_model.h"
#include "tools/scene/analytic.h"

namespace ff::chart {
namespace {

using bake::test::addMaterial;
using bake::test::addQuad;
constexpr double kPi = std::numbers::pi;
constexpr Vec3 kGrey{0.5f, 0.5f, 0.5f}, kBlack{};

Vec3 radianceOf(float emitted_w_m2) {
  const float l = emitted_w_m2 / static_cast<float>(kPi);
  return {l, l, l};
}

// A unit square at height y, x from `x0`, that faces up or down.
void level(bake::Scene& s, float x0, float y, bool up, uint32_t material, float size = 1) {
  const Vec3 a{x0, y, 0}, b{x0, y, size}, c{x0 + size, y, size}, d{x0 + size, y, 0};
  if (up) addQuad(s, a, b, c, d, material);
  else addQuad(s, a, d, c, b, material);
}

struct Mean {
  double value = 0, error = 0;
};

// A scene with its world in a folder of its own, and its tracer.
class Traced {
 public:
  Traced(bake::Scene made, float cell_m) : scene(std::move(made)), folder_(testing::TempDir() + "chart_truth_XXXXXX") {
    scene.name = "test scene";
    if (!mkdtemp(folder_.data())) throw std::runtime_error("no temporary folder");
    const std::string path = folder_ + "/world.ffm";
    const auto baked = bake::bakeWorld(scene, {.cell_m = cell_m, .rays = 32, .threads = 1}, path);
    if (!baked) throw std::runtime_error(baked.error().line());
    auto opened = formats::WholeWorld::open(path);
    if (!opened) throw std::runtime_error(opened.error().line());
    world = std::make_unique<formats::WholeWorld>(std::move(*opened));
    auto created = PathTracer::create(scene, *world);
    if (!created) throw std::runtime_error(created.error().line());
    tracer = std::make_unique<PathTracer>(std::move(*created));
    for (const formats::TileInfo& tile : world->tiles(0)) {
      const auto strip = world->strip(tile.id);
      if (!strip) throw std::runtime_error(strip.error().line());
      nodes.insert(nodes.end(), strip->nodes.begin(), strip->nodes.end());
    }
  }
  ~Traced() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }

  std::vector<uint32_t> where(const std::function<bool(const formats::Node&)>& wanted) const {
    std::vector<uint32_t> found;
    for (uint32_t p = 0; p < nodes.size(); ++p)
      if (wanted(nodes[p])) found.push_back(p);
    return found;
  }
  std::vector<uint32_t> all() const {
    return where([](const formats::Node&) { return true; });
  }
  std::vector<uint32_t> facing(Vec3 normal, float y) const {
    return where([&](const formats::Node& n) { return dot(n.normal, normal) > 0.9f && std::abs(n.centroid.y - y) < 0.01f; });
  }
  std::vector<PatchTruth> trace(std::span<const uint32_t> patches, const Lighting& light, uint32_t paths) const {
    return tracer->trace(patches, light, {.paths = paths, .threads = 1});
  }
  // Reflected radiosity of the green channel, over the area of the patches.
  Mean mean(std::span<const uint32_t> patches, const Lighting& light, uint32_t paths) const {
    const auto truth = trace(patches, light, paths);
    Mean m;
    double area = 0;
    for (size_t k = 0; k < patches.size(); ++k) {
      const auto a = static_cast<double>(nodes[patches[k]].area_m2), e = static_cast<double>(truth[k].error.y);
      area += a;
      m.value += a * static_cast<double>(truth[k].reflected.y);
      m.error += a * a * e * e;
    }
    return {m.value / area, std::sqrt(m.error) / area};
  }

  bake::Scene scene;
  std::unique_ptr<formats::WholeWorld> world;
  std::unique_ptr<PathTracer> tracer;
  std::vector<formats::Node> nodes;

 private:
  std::string folder_;
};

const Lighting kLamps{.name = "lamps", .sky = {}, .sun = {}, .lamps = 1};

// Irradiance of a point from a polygon of uniform radiance, its corners counter-clockwise seen from the point. The
// polygon lies above the point's horizon. Lambert. Photometria. 1760; Baum, Rushmeier, Winget. Improving Radiosity
// Solutions Through the Use of Analytically Determined Form-Factors. 1989, equation 6.
double irradianceFrom(std::span<const Vec3> polygon, double radiance, Vec3 point, Vec3 normal) {
  double sum = 0;
  for (size_t i = 0; i < polygon.size(); ++i) {
    const Vec3 a = normalized(polygon[i] - point), b = normalized(polygon[(i + 1) % polygon.size()] - point);
    const auto angle = std::acos(std::clamp(static_cast<double>(dot(a, b)), -1.0, 1.0));
    sum += angle * static_cast<double>(dot(normalized(cross(a, b)), normal));
  }
  return std::abs(sum) * radiance / 2;
}

// Mean over a patch's drawing geometry of a function of the point, by the midpoints of 15 x 15 pieces of each triangle.
double meanOver(const formats::WholeWorld& world, uint32_t patch, const std::function<double(Vec3)>& f) {
  constexpr int kPieces = 15;
  const uint32_t tile = world.tileOf(0, patch);
  const auto geometry = world.geometry(tile);
  if (!geometry) throw std::runtime_error(geometry.error().line());
  double sum = 0, area = 0;
  for (size_t t = 0; t < geometry->exposed(); ++t) {
    if (world.tiles(0)[tile].first_node + geometry->patch[t] != patch) continue;
    const Vec3 a = geometry->positions[3 * t], ab = geometry->positions[3 * t + 1] - a, ac = geometry->positions[3 * t + 2] - a;
    const double piece = static_cast<double>(length(cross(ab, ac))) / 2 / (kPieces * kPieces);
    for (int i = 0; i < kPieces; ++i)
      for (int j = 0; j < kPieces - i; ++j)
        for (const float third : {1.0f / 3, 2.0f / 3}) {
          if (third > 0.5f && i + j + 1 >= kPieces) continue;
          sum += piece * f(a + ab * ((static_cast<float>(i) + third) / kPieces) + ac * ((static_cast<float>(j) + third) / kPieces));
          area += piece;
        }
  }
  return sum / area;
}

// The squares of errors over their standard errors. Of 16 batches they follow t squared of 15 degrees of freedom: mean
// 15/13 = 1.15, standard deviation 1.84.
double meanSquaredScore(std::span<const PatchTruth> truth, std::span<const double> known) {
  double sum = 0;
  for (size_t k = 0; k < truth.size(); ++k) {
    const double z = (static_cast<double>(truth[k].reflected.y) - known[k]) / static_cast<double>(truth[k].error.y);
    sum += z * z;
  }
  return sum / static_cast<double>(truth.size());
}

TEST(PathTracer, AClosedRoomMultipliesItsLightByOneOverOneMinusAlbedo) {
  for (const float albedo : {0.5f, 0.9f}) {
    const Traced t(sceneOf(tools::furnaceBox(albedo, 2)), 0.25f);
    const double known = 2.0 * static_cast<double>(albedo) / (1 - static_cast<double>(albedo));
    const Mean m = t.mean(t.all(), kLamps, 1024);
    EXPECT_LT(m.error, 0.004 * known);
    EXPECT_NEAR(m.value, known, 4 * m.error) << "albedo " << albedo;
  }
}

TEST(PathTracer, ALampLightsASquareByTheirFormFactor) {
  struct Case {
    tools::SceneModel model;
    double form_factor;
    Vec3 normal;
  };
  for (const Case& c : {Case{tools::parallelPlates(1, 0.6f, 3), 0.199824895698, {0, -1, 0}},
                        Case{tools::perpendicularPlates(0.6f, 3), 0.200043776075, {1, 0, 0}}}) {
    bake::Scene scene = sceneOf(c.model);
    scene.materials[0].base_color = kBlack;  // the lamp sends nothing back
    const Traced t(std::move(scene), 0.25f);
    const Mean m = t.mean(t.where([&](const formats::Node& n) { return dot(n.normal, c.normal) > 0.9f; }), kLamps, 2048);
    const double known = static_cast<double>(0.6f) * 3 * c.form_factor;
    EXPECT_LT(m.error, 0.005 * known);
    EXPECT_NEAR(m.value, known, 4 * m.error) << c.model.name;
  }
}

TEST(PathTracer, AnOpenPatchSeesItsHemisphereOfALinearSky) {
  const Vec3 normal = normalized({0.3f, 1, -0.2f}), along = normalized(cross(normal, {0, 0, 1})), across = cross(normal, along);
  bake::Scene scene;
  const uint32_t white = addMaterial(scene, {0.8f, 0.5f, 0.2f});
  addQuad(scene, {}, along, along + across, across, white);
  const Traced t(std::move(scene), 2);
  ASSERT_GT(dot(t.nodes[0].normal, normal), 0.99f);
  Lighting light{.name = "sky", .sky = {{1.1f, 1.4f, 1.9f}, {{0, 0.4f, 0}, {0.3f, 0.5f, 0}, {0, 0.7f, 0.2f}}}, .sun = {}};
  const auto truth = t.trace(t.all(), light, 4096);
  for (size_t p = 0; p < truth.size(); ++p)
    for (int c = 0; c < 3; ++c) {
      const Vec3 albedo{0.8f, 0.5f, 0.2f};
      const double known = kPi * static_cast<double>(albedo[c] * (light.sky.l0[c] + 2.0f / 3 * dot(light.sky.l1[c], normal)));
      EXPECT_NEAR(static_cast<double>(truth[p].reflected[c]), known, 4 * static_cast<double>(truth[p].error[c]) + 1e-5 * known);
      EXPECT_EQ(truth[p].reflected[c], truth[p].direct[c]);
    }
}

TEST(PathTracer, TheSunShinesOnATiltedPlaneByTheCosine) {
  const Vec3 normal = normalized({0.3f, 1, -0.2f}), along = normalized(cross(normal, {0, 0, 1})), across = cross(normal, along);
  bake::Scene scene;
  addQuad(scene, {}, along, along + across, across, addMaterial(scene, kGrey));
  const Traced t(std::move(scene), 0.5f);
  Lighting light{.name = "sun", .sky = {}, .to_sun = normalized({1, 2, 0.5f}), .sun = {10, 8, 6}};
  const std::vector<uint32_t> all = t.all();
  const auto truth = t.trace(all, light, 64);
  const std::vector<Vec3> sun = t.tracer->sunIrradiance(all, light, 16);
  for (size_t p = 0; p < all.size(); ++p) {
    const float known = 8 * dot(normal, light.to_sun);
    EXPECT_NEAR(truth[p].reflected.y, 0.5f * known, 1e-4f);
    EXPECT_NEAR(truth[p].sun.y, known, 1e-4f);
    EXPECT_NEAR(sun[p].y, known, 1e-4f);
  }
  light.to_sun = light.to_sun * -1.0f;
  EXPECT_EQ(t.mean(all, light, 16).value, 0) << "from behind";
}

// Everything at the floor but the half under the sheet is in the sun; the sheet's back takes what the floor sends up.
TEST(PathTracer, AnOccluderShadesWhatLiesUnderIt) {
  bake::Scene scene;
  level(scene, 0, 0, true, addMaterial(scene, kGrey));
  const uint32_t sheet = addMaterial(scene, kGrey);
  addQuad(scene, {-1, 1, -1}, {-1, 1, 2}, {0.37f, 1, 2}, {0.37f, 1, -1}, sheet);
  const Traced t(std::move(scene), 0.25f);
  const Lighting light{.name = "sun", .sky = {}, .to_sun = {0, 1, 0}, .sun = {10, 10, 10}};
  const std::vector<uint32_t> floor = t.facing({0, 1, 0}, 0);
  const auto truth = t.trace(floor, light, 1024);
  const std::vector<Vec3> sun = t.tracer->sunIrradiance(floor, light, 256);
  double summed = 0, summed_sun = 0;
  for (size_t k = 0; k < floor.size(); ++k) {
    const formats::Node& n = t.nodes[floor[k]];
    if (n.centroid.x < 0.2f) {
      EXPECT_EQ(truth[k].reflected.y, 0) << "the sheet's back absorbs, the sun is hidden";
    } else if (n.centroid.x > 0.6f) {
      EXPECT_NEAR(truth[k].reflected.y, 5, 1e-4f);
    }
    summed += static_cast<double>(n.area_m2 * truth[k].reflected.y);
    summed_sun += static_cast<double>(n.area_m2 * sun[k].y);
  }
  // An edge across a patch, by evenly spread points of it.
  EXPECT_NEAR(summed, 5 * 0.63, 5 * 0.002);
  EXPECT_NEAR(summed_sun, 10 * 0.63, 10 * 0.004);
}

// A scrap 100 km away: were rays lifted by the scene's largest coordinate, 40 cm, they would start above the sheet.
TEST(PathTracer, WhatLiesFarAwayDoesNotLiftRaysOffWhatIsNear) {
  bake::Scene scene;
  const uint32_t grey = addMaterial(scene, kGrey);
  level(scene, 0, 0, true, grey);
  addQuad(scene, {-1, 0.1f, -1}, {-1, 0.1f, 2}, {2, 0.1f, 2}, {2, 0.1f, -1}, addMaterial(scene, kGrey));
  scene.materials.back().double_sided = true;
  bake::Scene far = scene;
  level(far, 1e5f, 0, true, grey);
  const Traced near_alone(std::move(scene), 0.5f);
  const auto created = PathTracer::create(far, *near_alone.world);
  ASSERT_TRUE(created) << created.error().line();
  const Lighting light{.name = "sun", .sky = {{1, 1, 1}, {}}, .to_sun = {0, 1, 0}, .sun = {10, 10, 10}};
  const auto floor = near_alone.facing({0, 1, 0}, 0);
  ASSERT_FALSE(floor.empty());
  const TraceSettings settings{.paths = 256, .threads = 1};
  const auto with = created->trace(floor, light, settings), without = near_alone.tracer->trace(floor, light, settings);
  for (size_t k = 0; k < floor.size(); ++k) {
    EXPECT_EQ(with[k].sun.y, 0) << "the sheet hides the sun";
    EXPECT_NEAR(with[k].reflected.y, without[k].reflected.y, 1e-4f);
  }
}

// All but 3 % of the floor lies under a solid, where no path counts: 40 % of the groups of 16 paths have none that does.
TEST(PathTracer, APatchMostlyBuriedIsWorthWhatIsSeenOfIt) {
  bake::Scene scene;
  level(scene, 0, 0, true, addMaterial(scene, kGrey));
  bake::test::addBlock(scene, {-0.5f, -0.25f, -0.5f}, {0.97f, 0.25f, 1.5f}, addMaterial(scene, kBlack));
  const Traced t(std::move(scene), 2);
  const Lighting light{.name = "sun", .sky = {}, .to_sun = {0, 1, 0}, .sun = {10, 10, 10}};
  const std::vector<uint32_t> floor = t.facing({0, 1, 0}, 0);
  ASSERT_EQ(floor.size(), 1u);
  const PatchTruth truth = t.trace(floor, light, 256)[0];
  EXPECT_FALSE(truth.buried);
  EXPECT_NEAR(truth.sun.y, 10, 1e-4);
  EXPECT_NEAR(truth.reflected.y, 5, 1e-4);
  EXPECT_NEAR(truth.direct.y, 5, 1e-4);
  EXPECT_NEAR(t.tracer->sunIrradiance(floor, light, 256)[0].y, 10, 1e-4);
}

TEST(PathTracer, OnlyLampGroupsThatAreOnShine) {
  bake::Scene scene;
  const uint32_t floor = addMaterial(scene, kGrey);
  for (const float x : {0.0f, 40.0f}) {  // each lamp is a material, and so a group, of its own
    level(scene, x, 0, true, floor);
    level(scene, x, 1, false, addMaterial(scene, kBlack, radianceOf(4)));
  }
  const Traced t(std::move(scene), 0.5f);
  const auto near = [&](float x) {
    return t.where([&](const formats::Node& n) { return n.centroid.y < 0.5f && std::abs(n.centroid.x - x - 0.5f) < 1; });
  };
  Lighting light{.name = "one lamp", .sky = {}, .sun = {}, .lamps = 0.5f, .groups = {0}};
  const double known = 0.5 * 0.5 * 4 * 0.199824895698;
  const Mean lit = t.mean(near(0), light, 4096);
  EXPECT_NEAR(lit.value, known, 4 * lit.error);
  EXPECT_LT(t.mean(near(40), light, 256).value, 1e-5) << "a lamp 40 m away, almost edge on";
  light.groups.clear();
  const Mean other = t.mean(near(40), light, 4096);
  EXPECT_NEAR(other.value, known, 4 * other.error);
}

// Walls of two sides that shine and reflect on both: the room inside is a furnace, outside there is only the sky.
TEST(PathTracer, DoubleSidedSurfacesReflectAndShineOnBothSides) {
  bake::Scene scene = sceneOf(tools::furnaceBox(0.5f, 2));
  scene.materials[0].double_sided = true;
  const Traced t(std::move(scene), 0.5f);
  const auto side = [&](bool inside) {
    return t.where([&](const formats::Node& n) { return (dot(n.normal, Vec3{0.5f, 0.5f, 0.5f} - n.centroid) > 0) == inside; });
  };
  ASSERT_EQ(side(true).size(), side(false).size());
  const Lighting light{.name = "sky and lamps", .sky = {{1, 1, 1}, {}}, .sun = {}, .lamps = 1};
  const Mean in = t.mean(side(true), light, 1024), out = t.mean(side(false), light, 1024);
  EXPECT_NEAR(in.value, 2, 4 * in.error);
  EXPECT_LT(in.error, 0.01);
  EXPECT_NEAR(out.value, 0.5 * kPi, 4 * out.error + 1e-5);
}

// A lamp under a sheet: the sheet's front sends light back, its back none.
TEST(PathTracer, BacksOfSingleSidedSurfacesAbsorb) {
  for (const bool front : {true, false}) {
    bake::Scene scene;
    level(scene, 0, 0, true, addMaterial(scene, kGrey, radianceOf(2)));
    level(scene, 0, 1, !front, addMaterial(scene, {0.9f, 0.9f, 0.9f}));
    const Traced t(std::move(scene), 0.5f);
    const Mean floor = t.mean(t.facing({0, 1, 0}, 0), kLamps, 512);
    if (!front) {
      EXPECT_EQ(floor.value, 0);
    } else {
      // Two bounces between squares whose F is 0.2: 0.5 0.9 F F 2 = 0.036, more where they see each other best.
      EXPECT_GT(floor.value, 0.035);
      EXPECT_LT(floor.value, 0.06);
    }
  }
}

TEST(PathTracer, StandardErrorsAreTrue) {
  const Traced t(sceneOf(tools::furnaceBox(0.7f, 3)), 0.1f);
  const std::vector<uint32_t> all = t.all();
  ASSERT_GE(all.size(), 600u);
  const std::vector<double> known(all.size(), 7);
  const double score = meanSquaredScore(t.trace(all, kLamps, 1024), known);
  // 1.84 / sqrt(600) = 0.075, four times.
  EXPECT_NEAR(score, 15.0 / 13, 0.30);
}

// A large lamp close to the floor and a small one far off: near the first, lamps are met about as often as they are asked.
TEST(PathTracer, LampsAskedAndLampsMetAddUpToEachPatchsLight) {
  bake::Scene scene;
  const uint32_t floor = addMaterial(scene, kGrey), close = addMaterial(scene, kBlack, radianceOf(4)),
                 high = addMaterial(scene, kBlack, radianceOf(20));
  level(scene, 0, 0, true, floor, 2);
  const std::vector<Vec3> near_lamp{{0.1f, 0.4f, 0.1f}, {1.6f, 0.4f, 0.1f}, {1.6f, 0.4f, 1.6f}, {0.1f, 0.4f, 1.6f}};
  const std::vector<Vec3> far_lamp{{3, 3, 0.4f}, {3.4f, 3, 0.4f}, {3.4f, 3, 0.8f}, {3, 3, 0.8f}};
  addQuad(scene, near_lamp[0], near_lamp[1], near_lamp[2], near_lamp[3], close);
  addQuad(scene, far_lamp[0], far_lamp[1], far_lamp[2], far_lamp[3], high);
  const Traced t(std::move(scene), 0.1f);
  // The near lamp hides the far one from the floor at x <= 1.4, z <= 1.8: only patches outside of that.
  const auto clear = t.where([](const formats::Node& n) {
    return n.centroid.y < 0.01f && (n.centroid.x > 1.45f || n.centroid.z > 1.85f);
  });
  ASSERT_GE(clear.size(), 100u);
  std::vector<double> known;
  for (const uint32_t p : clear)
    known.push_back(0.5 * meanOver(*t.world, p, [&](Vec3 at) {
                      return irradianceFrom(near_lamp, 4 / kPi, at, {0, 1, 0}) + irradianceFrom(far_lamp, 20 / kPi, at, {0, 1, 0});
                    }));
  const auto truth = t.trace(clear, kLamps, 2048);
  double bias = 0, error = 0;
  for (size_t k = 0; k < clear.size(); ++k) {
    bias += (static_cast<double>(truth[k].reflected.y) - known[k]) / known[k];
    const double e = static_cast<double>(truth[k].error.y) / known[k];
    error += e * e;
  }
  const auto n = static_cast<double>(clear.size());
  EXPECT_LT(std::sqrt(error) / n, 0.002) << "or the test says little";
  EXPECT_NEAR(bias / n, 0, 4 * std::sqrt(error) / n);
  EXPECT_NEAR(meanSquaredScore(truth, known), 15.0 / 13, 4 * 1.84 / std::sqrt(n));
}

TEST(PathTracer, GivesTheSameNumbersWhateverTheThreadsAndTheCompany) {
  const Traced t(sceneOf(tools::furnaceBox(0.5f, 2)), 0.25f);
  Lighting light = kLamps;
  const std::vector<uint32_t> all = t.all(), few{all[7], all[2]};
  const auto one = t.tracer->trace(all, light, {.paths = 64, .seed = 5, .threads = 1});
  const auto four = t.tracer->trace(all, light, {.paths = 64, .seed = 5, .threads = 4});
  const auto other = t.tracer->trace(few, light, {.paths = 64, .seed = 5, .threads = 2});
  for (size_t k = 0; k < all.size(); ++k) {
    EXPECT_EQ(one[k].reflected, four[k].reflected);
    EXPECT_EQ(one[k].error, four[k].error);
  }
  EXPECT_EQ(other[0].reflected, one[7].reflected);
  EXPECT_EQ(other[1].reflected, one[2].reflected);
  const auto reseeded = t.tracer->trace(few, light, {.paths = 64, .seed = 6, .threads = 1});
  EXPECT_NE(reseeded[0].reflected, one[7].reflected);
}

// Texels of a chequered image, nearest one, decoded by hand: 0 -> 0, 255 -> 1, 188 -> 0.5029, 64 -> 0.0513.
TEST(PathTracer, ReadsAlbedoFromTheTexture) {
  bake::Scene scene;
  const uint32_t m = addMaterial(scene, {1, 0.5f, 1});
  level(scene, 0, 0, true, m);
  scene.images.push_back({2, 2, {255, 255, 0, 255, 188, 188, 0, 255, 64, 64, 64, 255, 0, 0, 255, 255}});
  scene.materials[m].base_image = 0;
  for (const Vec3& p : scene.positions) scene.uv0.push_back({p.x, p.z});
  const Traced t(std::move(scene), 1.5f);
  const Lighting light{.name = "sky", .sky = {{1, 1, 1}, {}}, .sun = {}};
  double got[3] = {}, error[3] = {};
  const auto truth = t.trace(t.all(), light, 16384);
  for (size_t p = 0; p < truth.size(); ++p)
    for (int c = 0; c < 3; ++c) {
      got[c] += static_cast<double>(t.nodes[p].area_m2 * truth[p].reflected[c]);
      error[c] = std::hypot(error[c], static_cast<double>(t.nodes[p].area_m2 * truth[p].error[c]));
    }
  const double known[3] = {(1 + 0.50289 + 0.05127 + 0) / 4, 0.5 * (1 + 0.50289 + 0.05127 + 0) / 4, (0 + 0 + 0.05127 + 1) / 4};
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(got[c], kPi * known[c], 4 * error[c]);
    EXPECT_LT(error[c], 0.02 * known[c]);
  }
}

// A lamp half of whose texture is black, so that the middle of one of its triangles may be: that half is met, never asked.
TEST(PathTracer, ALampWithATextureShinesWhereItsTextureDoes) {
  bake::Scene scene;
  const uint32_t floor = addMaterial(scene, kGrey), lamp = addMaterial(scene, kBlack, radianceOf(4));
  level(scene, 0, 0, true, floor);
  level(scene, 0, 1, false, lamp);
  scene.images.push_back({2, 1, {255, 255, 255, 255, 0, 0, 0, 255}});
  scene.materials[lamp].emission_image = 0;
  for (const Vec3& p : scene.positions) scene.uv1.push_back({p.x, p.z});
  const Traced t(std::move(scene), 0.25f);
  const std::vector<uint32_t> below = t.facing({0, 1, 0}, 0);
  const std::vector<Vec3> shining{{0, 1, 0}, {0.5f, 1, 0}, {0.5f, 1, 1}, {0, 1, 1}};
  double known = 0;
  for (const uint32_t p : below)
    known += static_cast<double>(t.nodes[p].area_m2) * 0.5 *
             meanOver(*t.world, p, [&](Vec3 at) { return irradianceFrom(shining, 4 / kPi, at, {0, 1, 0}); });
  const Mean m = t.mean(below, kLamps, 2048);
  EXPECT_LT(m.error, 0.01 * known);
  EXPECT_NEAR(m.value, known, 4 * m.error);
}

TEST(PathTracer, LightGoesThroughTheHolesOfACutout) {
  bake::Scene scene;
  level(scene, 0, 0, true, addMaterial(scene, kGrey));
  const uint32_t leaf = addMaterial(scene, kGrey);
  level(scene, 0, 0.5f, true, leaf);
  scene.images.push_back({2, 1, {255, 255, 255, 255, 255, 255, 255, 0}});
  scene.materials[leaf].base_image = 0;
  scene.materials[leaf].cutout = true;
  for (const Vec3& p : scene.positions) scene.uv0.push_back({p.x, p.z});
  const Traced t(std::move(scene), 0.25f);
  const Lighting light{.name = "sun", .sky = {}, .to_sun = {0, 1, 0}, .sun = {10, 10, 10}};
  for (const uint32_t p : t.facing({0, 1, 0}, 0))
    EXPECT_NEAR(t.trace(std::vector<uint32_t>{p}, light, 64)[0].sun.y, t.nodes[p].centroid.x > 0.5f ? 10 : 0, 1e-4);
}

TEST(PathTracer, RefusesAWorldOfAnotherSceneInOneLine) {
  const Traced t(sceneOf(tools::furnaceBox(0.5f, 2)), 0.25f);
  bake::Scene elsewhere = t.scene;
  elsewhere.name = "another.glb";
  for (Vec3& p : elsewhere.positions) p += Vec3{0.4f, 0.3f, 0.2f};
  const auto refused = PathTracer::create(elsewhere, *t.world);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalidFile);
  const std::string line = refused.error().line();
  EXPECT_NE(line.find("another.glb"), std::string::npos) << line;
  EXPECT_NE(line.find(t.world->path()), std::string::npos) << line;
  EXPECT_EQ(line.find('\n'), std::string::npos);
}

TEST(PathTracer, RefusesAWorldWithoutDrawingGeometry) {
  bake::Scene scene = sceneOf(tools::furnaceBox(0.5f, 2));
  scene.name = "box";
  std::string folder = testing::TempDir() + "chart_truth_bare_XXXXXX";
  ASSERT_TRUE(mkdtemp(folder.data()));
  {
    ASSERT_TRUE(bake::bakeWorld(scene, {.cell_m = 0.5f, .rays = 16, .threads = 1, .geometry = false}, folder + "/w.ffm"));
    const auto world = formats::WholeWorld::open(folder + "/w.ffm");
    ASSERT_TRUE(world) << world.error().line();
    const auto refused = PathTracer::create(scene, *world);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalidFile);
  }
  std::filesystem::remove_all(folder);
}

TEST(PathTracer, SeesTheSideOfADoubleSidedSurfaceThatFacesTheRay) {
  bake::Scene scene;
  level(scene, 0, 0, true, addMaterial(scene, kGrey));
  scene.materials[0].double_sided = true;
  const Traced t(std::move(scene), 0.25f);
  for (int i = 0; i < 100; ++i) {
    const float x = 0.05f + 0.9f * static_cast<float>(i) / 100;
    for (const float side : {1.0f, -1.0f}) {
      const uint32_t seen = t.tracer->patchSeen({x, 2 * side, 0.31f}, normalized({0.1f, -side, 0.05f}));
      if (seen == PathTracer::kNoPatch) continue;  // past the edge
      EXPECT_GT(t.nodes[seen].normal.y * side, 0.9f);
    }
    EXPECT_NE(t.tracer->patchSeen({x, 2, 0.31f}, {0, -1, 0}), PathTracer::kNoPatch) << x;
    EXPECT_NE(t.tracer->patchSeen({x, -2, 0.31f}, {0, 1, 0}), PathTracer::kNoPatch) << x;
  }
}

TEST(PathTracer, SeesPatchesFromTheFrontAlone) {
  bake::Scene scene;
  level(scene, 0, 0, true, addMaterial(scene, kGrey));
  const Traced t(std::move(scene), 2);
  const uint32_t seen = t.tracer->patchSeen({0.3f, 2, 0.3f}, {0, -1, 0});
  ASSERT_LT(seen, t.nodes.size());
  EXPECT_EQ(t.tracer->patchSeen({0.3f, -2, 0.3f}, {0, 1, 0}), PathTracer::kNoPatch) << "a back";
  EXPECT_EQ(t.tracer->patchSeen({0.3f, 2, 0.3f}, {0, 1, 0}), PathTracer::kNoPatch) << "the sky";
}

}  // namespace
}  // namespace ff::chart
