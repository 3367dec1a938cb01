// KHR_lights_punctual: units, places, directions, cones, names.
#include <numbers>

#include "tests/bake/import/gltf_file.h"

namespace ff::bake {
namespace {

using Json = nlohmann::json;
using formats::Light;

// A file of one triangle and nodes; nodes[0] holds the mesh.
GltfFile fileWith(const Json& lights, const std::vector<Json>& nodes) {
  GltfFile file;
  file.withTriangle();
  file.json["extensions"]["KHR_lights_punctual"]["lights"] = lights;
  file.json["scenes"] = {{{"nodes", {0}}}};
  for (const Json& node : nodes) {
    file.json["nodes"].push_back(node);
    file.json["scenes"][0]["nodes"].push_back(file.json["nodes"].size() - 1);
  }
  return file;
}

Json node(int light, Json more = Json::object()) {
  more["extensions"]["KHR_lights_punctual"]["light"] = light;
  return more;
}

Scene importLights(const Json& lights, const std::vector<Json>& nodes) {
  const TempFolder folder;
  return importGood(fileWith(lights, nodes).save(folder, "l.glb"));
}

TEST(ImportLights, CandelaAndLuxAreWattsOneForOne) {
  const Scene scene = importLights(Json::parse(R"([{"type": "point", "intensity": 100, "color": [1, 0.5, 0.25], "range": 7},
      {"type": "directional", "intensity": 3, "name": "sun"}, {"type": "spot", "name": "lamp"}])"),
                                   {node(0, {{"translation", {2, 2, 2}}}), node(1), node(2, {{"name", "desk"}})});
  ASSERT_EQ(scene.lights.size(), 3u);
  EXPECT_EQ(scene.lights[0], (Light{"light 0", Light::kPoint, {100, 50, 25}, {2, 2, 2}, {}, 7, 0, 0}));
  EXPECT_EQ(scene.lights[1], (Light{"sun", Light::kDirectional, {3, 3, 3}, {}, {0, 0, -1}, 0, 0, 0}));
  EXPECT_EQ(scene.lights[2], (Light{"desk", Light::kSpot, {1, 1, 1}, {}, {0, 0, -1}, 0, 0, std::numbers::pi_v<float> / 4}));
  EXPECT_TRUE(scene.warnings.size() == 1 && scene.left_alone.empty()) << "the surface without a material alone";
}

// A node's transform turns and moves a light; its scale, even a mirror's, changes neither reach nor strength.
TEST(ImportLights, StandWhereTheirNodesStand) {
  const Json lights = Json::parse(R"([{"type": "spot", "intensity": 5, "range": 3, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.3}}])");
  const double h = std::numbers::sqrt2 / 2;
  struct Case {
    Json node;
    Vec3 position, direction;
  };
  for (const Case& c : std::vector<Case>{
           {{{"translation", {1, 2, 3}}}, {1, 2, 3}, {0, 0, -1}},
           {{{"rotation", {-h, 0, 0, h}}}, {}, {0, -1, 0}},  // a quarter turn about x: looks down
           {{{"rotation", {0, h, 0, h}}, {"scale", {5, 5, 5}}}, {}, {-1, 0, 0}},
           {{{"scale", {-1, 1, 1}}, {"translation", {0, 4, 0}}}, {0, 4, 0}, {0, 0, -1}},
           {{{"scale", {1, 1, -2}}}, {}, {0, 0, 1}},
           {{{"matrix", {0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 9, 8, 7, 1}}}, {9, 8, 7}, {-1, 0, 0}}}) {
    const Scene scene = importLights(lights, {node(0, c.node)});
    ASSERT_EQ(scene.lights.size(), 1u) << c.node;
    expectNear(scene.lights[0].position, c.position, 1e-6f);
    expectNear(scene.lights[0].direction, c.direction, 1e-6f);
    EXPECT_EQ(scene.lights[0].color_intensity, (Vec3{5, 5, 5}));
    EXPECT_EQ(scene.lights[0].range_m, 3);
    EXPECT_FLOAT_EQ(scene.lights[0].inner_angle, 0.1f);
    EXPECT_FLOAT_EQ(scene.lights[0].outer_angle, 0.3f);
  }
}

// A file in centimetres: its lengths are, a light's range among them; its candela and lux are not.
TEST(ImportLights, AreScaledInPlaceAndRangeByTheFilesUnit) {
  const Json lights = Json::parse(R"([{"type": "point", "intensity": 5, "range": 300}, {"type": "spot"}, {"type": "directional", "intensity": 2}])");
  const TempFolder folder;
  const Json high = {{"translation", {100, 200, 300}}, {"scale", {7, 7, 7}}};
  const auto scene = importGltf(fileWith(lights, {node(0, high), node(1, high), node(2, high)}).save(folder, "cm.glb"), {.scale = 0.01, .z_up = true});
  ASSERT_TRUE(scene) << scene.error().line();
  ASSERT_EQ(scene->lights.size(), 3u);
  const Vec3 down{0, -1, 0};  // -z of a file whose z is up
  const Light point = scene->lights[0], spot = scene->lights[1], sun = scene->lights[2];
  EXPECT_FLOAT_EQ(point.range_m, 3);
  EXPECT_EQ(spot.range_m, 0) << "without end";
  EXPECT_EQ(point.color_intensity, (Vec3{5, 5, 5}));
  EXPECT_EQ(sun.color_intensity, (Vec3{2, 2, 2}));
  EXPECT_FLOAT_EQ(spot.outer_angle, std::numbers::pi_v<float> / 4);
  for (const Light& l : {point, spot}) expectNear(l.position, {1, 3, -2}, 1e-6f);
  for (const Light& l : {spot, sun}) expectNear(l.direction, down, 1e-6f);
}

TEST(ImportLights, OfHiddenAndUnlistedNodesAreNotThere) {
  GltfFile file = fileWith(Json::parse(R"([{"type": "point"}])"), {node(0, {{"extensions", {{"KHR_node_visibility", {{"visible", false}}}}}}), node(0)});
  file.json["nodes"].push_back(node(0));  // in no scene
  const TempFolder folder;
  EXPECT_EQ(importGood(file.save(folder, "l.glb")).lights.size(), 1u);
}

TEST(ImportLights, WhatCannotBeIsClampedLeftAloneOrRefused) {
  const Scene scene = importLights(Json::parse(R"([{"type": "point", "intensity": -2}, {"type": "area"},
      {"type": "spot", "spot": {"innerConeAngle": 1, "outerConeAngle": 0.5}}, {"type": "spot", "spot": {"outerConeAngle": 3}}])"),
                                   {node(0), node(1), node(2), node(3), node(2, {{"scale", {0, 0, 0}}})});
  ASSERT_EQ(scene.lights.size(), 3u);
  EXPECT_EQ(scene.lights[0].color_intensity, Vec3{});
  EXPECT_LT(scene.lights[1].inner_angle, scene.lights[1].outer_angle);
  EXPECT_FLOAT_EQ(scene.lights[2].outer_angle, std::numbers::pi_v<float> / 2);
  ASSERT_EQ(scene.left_alone.size(), 1u);
  EXPECT_NE(scene.left_alone[0].find("\"area\""), std::string::npos);
  EXPECT_TRUE(warns(scene, "scale of 0"));
  const TempFolder folder;
  EXPECT_NE(importBad(fileWith(Json::parse(R"([{"type": "point"}])"), {node(1)}).save(folder, "b.glb")).find("node 1"), std::string::npos);
}

TEST(ImportLights, CountInTheHash) {
  std::vector<std::array<uint8_t, 16>> seen;
  for (const char* light : {R"([])", R"([{"type": "point"}])", R"([{"type": "point", "intensity": 2}])", R"([{"type": "point", "range": 2}])",
                            R"([{"type": "point", "name": "a"}])", R"([{"type": "directional"}])"}) {
    const Json lights = Json::parse(light);
    const Scene scene = importLights(lights, lights.empty() ? std::vector<Json>{} : std::vector{node(0)});
    for (const auto& other : seen) EXPECT_NE(scene.content_hash, other) << light;
    seen.push_back(scene.content_hash);
  }
}

}  // namespace
}  // namespace ff::bake
