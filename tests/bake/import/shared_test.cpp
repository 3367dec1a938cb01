// The importer on the files of ../shared/scenes: real scenes, odd ones and malformed ones. Skips aloud where they are
// absent.
#include <sys/resource.h>
#include <sys/wait.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <set>

#include "tests/bake/import/gltf_file.h"

namespace ff::bake {
namespace {

namespace fs = std::filesystem;

// FF_SHARED_SCENES in the environment names another folder than the one beside the checkout.
const fs::path kScenes = std::getenv("FF_SHARED_SCENES") ? std::getenv("FF_SHARED_SCENES") : FF_SHARED_SCENES;

#define SKIP_WITHOUT(path) \
  if (!fs::exists(path)) GTEST_SKIP() << "NOT TESTED: " << (path) << " is absent"

struct Expected {
  const char* file;
  size_t triangles;  // in the file, before triangles without area are dropped
  Vec3 extent_m;     // to the digits given
  float tolerance_m;
};

TEST(ImportShared, RealScenesHaveTheirTrianglesAndExtents) {
  SKIP_WITHOUT(kScenes / "cornell");
  // Less 98 light boxes that stand where others do, and clear glass, which stops no light.
  constexpr size_t kTwice = 98 * 12;
  const Expected all[] = {
      {"cornell/cornell.glb", 38, {0.556f, 0.549f, 0.559f}, 0.001f},
      {"living-room/living-room.glb", 143035 - 11166, {6, 3, 4}, 0.5f},
      {"staircase/staircase.glb", 262578 - 12720, {7, 7, 10}, 0.5f},
      {"classroom/classroom.glb", 103832, {222, 3, 222}, 0.5f},
      {"quake_e3m4/quake_e3m4.glb", 20356 - kTwice, {200, 72, 159}, 0.6f},
      {"minecraft_builds/minecraft_builds.glb", 228728, {256, 48, 384}, 0.01f},
      {"minetest/minetest_v7_108.glb", 127990, {108, 100, 108}, 0.01f},
      {"minetest/minetest_v7_512.glb", 1952574, {512, 128, 512}, 0.01f},
      {"terrain_st_helens/terrain_st_helens.glb", 296186, {9800, 1900, 14000}, 60},
      {"littlest_tokyo/LittlestTokyo_draco.glb", 141802, {545, 599, 552}, 1},
      {"draco/cornell_draco.glb", 38, {0.556f, 0.549f, 0.559f}, 0.001f},
      {"draco/classroom_draco.glb", 103832, {222, 3, 222}, 0.5f},
      {"draco/quake_e3m4_draco.glb", 20356 - kTwice, {200, 72, 159}, 0.6f},
      {"khronos/Box/glTF/Box.gltf", 12, {1, 1, 1}, 1e-6f},
      {"khronos/Duck/glTF-Binary/Duck.glb", 4212, {1.65f, 1.54f, 1.15f}, 0.01f},
      {"khronos/Lantern/glTF/Lantern.gltf", 5394, {15.5f, 25.7f, 4.6f}, 0.05f},
  };
  for (const Expected& expected : all) {
    SCOPED_TRACE(expected.file);
    const Scene scene = importGood((kScenes / expected.file).string());
    EXPECT_EQ(scene.triangles.size() + scene.without_area, expected.triangles);
    EXPECT_LE(scene.without_area, expected.triangles / 100);
    Box box;
    for (const Triangle& t : scene.triangles)
      for (const uint32_t v : t.v) box.add(scene.positions[v]);
    expectNear(box.hi - box.lo, expected.extent_m, expected.tolerance_m);
  }
}

TEST(ImportShared, CompressedAndPlainCornellAgree) {
  SKIP_WITHOUT(kScenes / "draco");
  const auto area = [](const Scene& scene) {
    double sum = 0;
    for (size_t t = 0; t < scene.triangles.size(); ++t) sum += 0.5 * length(areaVector(scene, t));
    return sum;
  };
  const double plain = area(importGood((kScenes / "cornell/cornell.glb").string()));
  // Positions are quantised to at least 11 bits over 0.56 m: each edge is off by at most 0.3 mm, an area by 0.2 %.
  EXPECT_NEAR(area(importGood((kScenes / "draco/cornell_draco.glb").string())) / plain, 1, 2e-3);
}

// Every file below a folder that is glTF by its name.
std::vector<fs::path> filesBelow(const fs::path& folder) {
  std::vector<fs::path> out;
  for (const auto& entry : fs::recursive_directory_iterator(folder))
    if (entry.path().extension() == ".gltf" || entry.path().extension() == ".glb") out.push_back(entry.path());
  std::sort(out.begin(), out.end());
  return out;
}

TEST(ImportShared, EveryEdgeFileLoadsSaveThoseThatLackBuffersOrAreInvalid) {
  SKIP_WITHOUT(kScenes / "edge");
  const std::set<std::string> refused = {
      "asset_generator/Compatibility/Compatibility_05.gltf",    // requires an extension that does not exist: must be
                                                                // refused
      "draco_testdata/CubeScaledInstances/glTF/cube_att.gltf",  // nodes with two parents
      "draco_testdata/KhronosSampleModels/DragonAttenuation/glTF/DragonAttenuation.gltf",  // its .bin is not there
      "draco_testdata/ZeroLengthBufferView/ZeroLengthBufferView.gltf",  // an empty bufferView; a vertex at 2e9 m
      "loaders_gl/2CylinderEngine-Draco.gltf"};                         // names a .bin that is not there
  size_t with_triangles = 0;
  for (const fs::path& file : filesBelow(kScenes / "edge")) {
    const std::string name = fs::relative(file, kScenes / "edge").string();
    SCOPED_TRACE(name);
    const auto scene = importGltf(file.string());
    EXPECT_EQ(bool(scene), refused.count(name) == 0) << (scene ? "loads" : scene.error().line());
    if (scene && !scene->triangles.empty()) ++with_triangles;
  }
  EXPECT_GE(with_triangles, 200u);
}

// Runs the importer as a child, as a user would, with its time and memory limited.
std::string faultOf(const fs::path& file, const std::string& expectation, const std::string& scratch) {
  const auto start = std::chrono::steady_clock::now();
  const pid_t child = fork();
  if (child == 0) {
    const rlimit seconds{10, 10};
    setrlimit(RLIMIT_CPU, &seconds);
    if (!freopen("/dev/null", "w", stdout) || !freopen(scratch.c_str(), "w", stderr)) _exit(99);
    execl(FF_IMPORT_CHECK, FF_IMPORT_CHECK, file.c_str(), static_cast<char*>(nullptr));
    _exit(98);
  }
  int status = 0;
  rusage usage{};
  if (wait4(child, &status, 0, &usage) != child) return "cannot wait";
  if (!WIFEXITED(status)) return "killed by signal " + std::to_string(WTERMSIG(status));
  const int rc = WEXITSTATUS(status);
  if (rc > 3) return "exit code " + std::to_string(rc);
  if (std::chrono::steady_clock::now() - start > std::chrono::seconds(10)) return "took more than 10 s";
  if (usage.ru_maxrss > 2 << 20) return "took " + std::to_string(usage.ru_maxrss >> 10) + " MiB";
  std::ifstream stream(scratch);
  const std::string text((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
  if (rc != 0 &&
      (std::count(text.begin(), text.end(), '\n') != 1 || text.find(file.filename().string()) == std::string::npos))
    return "no single line that names the file: " + text;
  if (rc != 0 && expectation == "ok") return "refused though valid: " + text;
  return {};
}

TEST(ImportShared, NoMalformedFileCrashesHangsOrEndsWithoutOneClearLine) {
  SKIP_WITHOUT(kScenes / "bad" / "MANIFEST.tsv");
  std::ifstream manifest(kScenes / "bad" / "MANIFEST.tsv");
  std::string line;
  std::getline(manifest, line);
  const TempFolder folder;
  size_t files = 0;
  while (std::getline(manifest, line)) {
    const size_t tab = line.find('\t'), tab2 = line.find('\t', tab + 1), tab3 = line.find('\t', tab2 + 1);
    const std::string file = line.substr(0, tab);
    EXPECT_EQ(faultOf(kScenes / "bad" / file, line.substr(tab2 + 1, tab3 - tab2 - 1), folder.file("stderr")), "")
        << file;
    ++files;
  }
  EXPECT_GE(files, 500u);
}

}  // namespace
}  // namespace ff::bake
