// What ffscene writes is what the baker reads.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <tuple>
#include <vector>

#include "bake/import/gltf_import.h"
#include "tools/scene/analytic.h"
#include "tools/scene/glb.h"
#include "tools/scene/kinds.h"
#include "tools/scene/town.h"

namespace ff::tools {
namespace {

// Nine coordinates, from the smallest corner on, and six of the material: equal for what shines and reflects alike.
using Flat = std::array<float, 15>;

Flat flat(std::array<Vec3, 3> t, Vec3 color, Vec3 radiance) {
  const auto before = [](Vec3 a, Vec3 b) { return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z); };
  std::rotate(t.begin(), std::min_element(t.begin(), t.end(), before), t.end());
  return {t[0].x, t[0].y, t[0].z, t[1].x, t[1].y, t[1].z, t[2].x, t[2].y, t[2].z,
          color.x, color.y, color.z, radiance.x, radiance.y, radiance.z};
}

class SceneImport : public testing::TestWithParam<bool> {
 protected:
  void expectRoundTrip(const SceneModel& model) {
    const auto path = std::filesystem::temp_directory_path() / ("ff_" + std::string(GetParam() ? "draco_" : "plain_") +
                                                               std::to_string(::getpid()) + "_" + model.name + ".glb");
    const auto written = writeGlb(model, path.string(), {.draco = GetParam()});
    ASSERT_TRUE(written) << written.error().line();
    const auto scene = bake::importGltf(path.string());
    std::filesystem::remove(path);
    ASSERT_TRUE(scene) << scene.error().line();
    EXPECT_TRUE(scene->warnings.empty()) << scene->warnings.front();
    std::vector<Flat> expected, got;
    for (const SceneNode& node : model.nodes)
      for (const ScenePart& part : node.parts)
        for (size_t i = 0; i < part.indices.size(); i += 3) {
          std::array<Vec3, 3> t;
          for (size_t k = 0; k < 3; ++k) t[k] = part.positions[part.indices[i + k]] * model.scale;
          const SceneMaterial& m = model.materials[part.material];
          // The file holds a colour up to 1 and a strength, as glTF wants it.
          const float strength = std::max({m.radiance.x, m.radiance.y, m.radiance.z});
          expected.push_back(flat(t, m.base_color, strength > 0 ? m.radiance / strength * strength : Vec3{}));
        }
    for (const bake::Triangle& t : scene->triangles) {
      const bake::Material& m = scene->materials[t.material];
      EXPECT_EQ(m.metallic, 0);
      EXPECT_FALSE(m.double_sided);
      got.push_back(flat({scene->positions[t.v[0]], scene->positions[t.v[1]], scene->positions[t.v[2]]}, m.base_color, m.emission));
    }
    std::ranges::sort(expected);
    std::ranges::sort(got);
    EXPECT_EQ(expected.size(), got.size());
    EXPECT_TRUE(expected == got);
  }
};

TEST_P(SceneImport, ReadsATownExactly) {
  for (const float cell : {1.0f, 0.25f}) {
    const auto town = makeTown({8000, 5, cell});
    ASSERT_TRUE(town);
    expectRoundTrip(townModel(*town, false));
  }
}

TEST_P(SceneImport, ReadsAMergedTownExactly) {
  const auto town = makeTown({8000, 5, 1});
  ASSERT_TRUE(town);
  expectRoundTrip(townModel(*town, true));
}

TEST_P(SceneImport, ReadsAnalyticScenesExactly) {
  expectRoundTrip(furnaceBox(0.5f, 1));
  expectRoundTrip(parallelPlates(1, 0.25f, 2));
  expectRoundTrip(coaxialDiscs(1, 64, 0.5f, 1));
  expectRoundTrip(sphericalCap(60, 64, 0.5f, 1));
  expectRoundTrip(twoRooms(0.1f, 0.5f, 1));
}

INSTANTIATE_TEST_SUITE_P(PlainAndDraco, SceneImport, testing::Bool(),
                         [](const auto& draco) { return draco.param ? "Draco" : "Plain"; });

}  // namespace
}  // namespace ff::tools
