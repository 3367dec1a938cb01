// Files from outside: each fault ends in one line that names file and place.
#include <sys/resource.h>

#include <limits>

#include "tests/bake/import/gltf_file.h"

namespace ff::bake {
namespace {

using Json = nlohmann::json;

// Refusal of a good file after one edit; `expected` must be in the line.
void expectRefusal(const std::string& expected, const std::function<void(GltfFile&)>& edit) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  file.primitive()["indices"] = file.accessor(std::vector<uint16_t>{0, 1, 2, 0}, 5123, "SCALAR");
  file.json["accessors"][1]["count"] = 3;
  edit(file);
  const std::string line = importBad(file.save(folder, "bad.glb"));
  EXPECT_NE(line.find(expected), std::string::npos) << line;
}

void set(GltfFile& file, const char* pointer, const Json& value) { file.json[Json::json_pointer(pointer)] = value; }

TEST(ImportHostile, RefusesReferencesOutOfRange) {
  expectRefusal("POSITION refers to accessor 99, there are 2",
                [](GltfFile& f) { set(f, "/meshes/0/primitives/0/attributes/POSITION", 99); });
  expectRefusal("indices must be a non-negative integer",
                [](GltfFile& f) { set(f, "/meshes/0/primitives/0/indices", -1); });
  expectRefusal("accessor 0: bufferView refers to bufferView 5",
                [](GltfFile& f) { set(f, "/accessors/0/bufferView", 5); });
  expectRefusal("bufferView 0: buffer refers to buffer 1", [](GltfFile& f) { set(f, "/bufferViews/0/buffer", 1); });
  expectRefusal("material refers to material 0", [](GltfFile& f) { set(f, "/meshes/0/primitives/0/material", 0); });
  expectRefusal("node 0: mesh refers to mesh 7", [](GltfFile& f) { set(f, "/nodes/0/mesh", 7); });
  expectRefusal("scene refers to scene 1", [](GltfFile& f) { set(f, "/scene", 1); });
}

TEST(ImportHostile, RefusesExtentsPastTheEndWithoutOverflow) {
  expectRefusal("accessor 0: count 4 needs 48 bytes from offset 0 but bufferView 0 has 36",
                [](GltfFile& f) { set(f, "/accessors/0/count", 4); });
  expectRefusal("accessor 0: count", [](GltfFile& f) { set(f, "/accessors/0/count", 9223372036854775807ull); });
  expectRefusal("accessor 0: byteOffset",
                [](GltfFile& f) { set(f, "/accessors/0/byteOffset", 18446744073709551612ull); });
  expectRefusal("accessor 0: count", [](GltfFile& f) { set(f, "/accessors/0/byteOffset", 9223372036854775804ull); });
  expectRefusal("bufferView 0: offset",
                [](GltfFile& f) { set(f, "/bufferViews/0/byteOffset", 9223372036854775804ull); });
  expectRefusal("bufferView 0: offset", [](GltfFile& f) { set(f, "/bufferViews/0/byteLength", 4096); });
  expectRefusal("bufferView 0: byteStride", [](GltfFile& f) { set(f, "/bufferViews/0/byteStride", 4294967292u); });
  expectRefusal("accessor 0: an element of 12 bytes", [](GltfFile& f) { set(f, "/bufferViews/0/byteStride", 4); });
  expectRefusal("buffer 0: byteLength", [](GltfFile& f) { set(f, "/buffers/0/byteLength", 1ull << 40); });
}

TEST(ImportHostile, RefusesAVertexNumberOutOfRange) {
  expectRefusal("index 2 (accessor 1) is vertex 3 of 3", [](GltfFile& f) { f.bytes[36 + 4] = 3; });
}

TEST(ImportHostile, RefusesCoordinatesThatAreNotFiniteOrTooFar) {
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()})
    expectRefusal("accessor 0: element 1", [bad](GltfFile& f) { std::memcpy(&f.bytes[12], &bad, 4); });
  expectRefusal("node 0: a world coordinate", [](GltfFile& f) { f.json["nodes"][0]["scale"] = {1e38, 1e38, 1e38}; });
}

TEST(ImportHostile, RefusesNodesThatAreNoTrees) {
  expectRefusal("node 0: is its own child", [](GltfFile& f) { f.json["nodes"][0]["children"] = {0}; });
  expectRefusal("cycle", [](GltfFile& f) { f.json["nodes"] = {{{"children", {1}}}, {{"children", {0}}}}; });
  expectRefusal("node 2: is a child twice", [](GltfFile& f) {
    f.json["nodes"] = {{{"children", {1, 2}}}, {{"children", {2}}}, {{"mesh", 0}}};
  });
  expectRefusal("scene 0: lists node 1, which is a child", [](GltfFile& f) {
    f.json["nodes"] = {{{"children", {1}}}, {{"mesh", 0}}};
    f.json["scenes"][0]["nodes"] = {0, 1};
  });
}

TEST(ImportHostile, RefusesSparseIndicesOutOfRangeOrOrder) {
  for (const auto& [indices, expected] : {std::pair{std::vector<uint16_t>{1, 3}, "sparse index 3 of 3"},
                                          std::pair{std::vector<uint16_t>{2, 1}, "must increase"}})
    expectRefusal(expected, [&](GltfFile& f) {
      f.json["accessors"][0]["sparse"] = {{"count", 2},
                                          {"indices", {{"bufferView", f.view(indices)}, {"componentType", 5123}}},
                                          {"values", {{"bufferView", f.view(std::vector<float>(6))}}}};
    });
}

TEST(ImportHostile, RefusesUrisThatLeaveTheFolder) {
  const TempFolder folder;
  for (const char* uri : {"/etc/passwd", "../x.bin", "a/../../x.bin", "%2e%2e%2fx.bin", "..%5cx.bin",
                          "file:///etc/passwd", "http://127.0.0.1:9/x.bin", ""}) {
    GltfFile file;
    file.withTriangle();
    file.json["buffers"] = {{{"byteLength", 36}, {"uri", uri}}};
    EXPECT_NE(importBad(file.save(folder, "u.gltf")).find("buffer 0"), std::string::npos) << uri;
  }
}

TEST(ImportHostile, AMissingBufferIsAnInputOutputError) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  file.json["buffers"] = {{{"byteLength", 36}, {"uri", "nowhere.bin"}}};
  const auto scene = importGltf(file.save(folder, "m.gltf"));
  ASSERT_FALSE(scene);
  EXPECT_EQ(scene.error().code, ErrorCode::kIo);
  EXPECT_EQ(importGltf(folder.file("no such file.glb")).error().code, ErrorCode::kIo);
  EXPECT_EQ(importGltf(folder.file("")).error().code, ErrorCode::kIo) << "a folder is no scene";
}

TEST(ImportHostile, RefusesDeepAndBrokenJson) {
  const TempFolder folder;
  EXPECT_NE(importBad(folder.write("a.gltf", "{\"a\":" + std::string(200000, '[') + std::string(200000, ']') + "}"))
                .find("nested"),
            std::string::npos);
  EXPECT_NE(importBad(folder.write("b.gltf", "{\"asset\": {\"version\": \"2.0\"}")).find("JSON"), std::string::npos);
  EXPECT_NE(importBad(folder.write("c.gltf", "{\"asset\": {\"version\": 2.0}}")).find("version"), std::string::npos);
  EXPECT_NE(importBad(folder.write("d.gltf", "{\"asset\": {\"version\": \"2.0\", \"n\": \"\xff\"}}")).find("UTF-8"),
            std::string::npos);
  EXPECT_NE(importBad(folder.write("e.gltf", "[1, 2]")).find("offset 0"), std::string::npos);
  EXPECT_NE(importBad(folder.write("f.gltf", "")).find("empty"), std::string::npos);
}

TEST(ImportHostile, RefusesAGlbCutAtEveryLength) {
  const TempFolder folder;
  GltfFile file;
  const std::string path = file.withTriangle().save(folder, "whole.glb");
  std::ifstream stream(path, std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
  for (size_t n = 0; n < whole.size(); ++n) {
    importBad(folder.write("cut.glb", whole.substr(0, n)));
    if (n < 20) continue;
    std::string agreeing = whole.substr(0, n);  // the header's length tells the truth about the cut
    agreeing.replace(8, 4, GltfFile::word(n));
    importBad(folder.write("cut.glb", agreeing));
  }
}

TEST(ImportHostile, SurvivesEveryByteOfAGlbSetToItsComplement) {
  const TempFolder folder;
  GltfFile file;
  const std::string path = file.withTriangle().save(folder, "whole.glb");
  std::ifstream stream(path, std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
  for (size_t n = 0; n < whole.size(); ++n) {
    std::string changed = whole;
    changed[n] = static_cast<char>(~changed[n]);
    const auto scene = importGltf(folder.write("changed.glb", changed));
    if (!scene) continue;
    for (const Vec3 p : scene->positions)
      EXPECT_TRUE(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z)) << n;
    for (const Triangle& t : scene->triangles)
      for (const uint32_t v : t.v) EXPECT_LT(v, scene->positions.size()) << n;
  }
}

TEST(ImportHostile, CountsWithoutBytesBehindThemStayWithinTheMemoryLimit) {
  expectRefusal("MiB", [](GltfFile& f) {  // 4 billion zeros but for one sparse element
    f.json["accessors"][0].erase("bufferView");
    f.json["accessors"][0]["count"] = 4000000000u;
    f.json["accessors"][0]["sparse"] = {
        {"count", 1},
        {"indices", {{"bufferView", f.view(std::vector<uint16_t>{1, 0})}, {"componentType", 5123}}},
        {"values", {{"bufferView", f.view(std::vector<float>(3))}}}};
    f.json["bufferViews"][2]["byteLength"] = 2;
    f.primitive().erase("indices");
  });
  expectRefusal("MiB", [](GltfFile& f) {  // as many instances
    f.json["accessors"].push_back(
        {{"componentType", 5126},
         {"type", "VEC3"},
         {"count", 4000000000u},
         {"sparse",
          {{"count", 1},
           {"indices", {{"bufferView", f.view(std::vector<uint8_t>{0})}, {"componentType", 5121}}},
           {"values", {{"bufferView", f.view(std::vector<float>(3))}}}}}});
    f.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"] = 2;
  });
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  EXPECT_LT(usage.ru_maxrss >> 10, 2048) << "MiB of this process, at its peak";
}

TEST(ImportHostile, AShortFileOfMillionsOfObjectsIsRefusedBeforeTheyAreBuilt) {
  const TempFolder folder;
  for (const char* kind : {"nodes", "materials", "textures"}) {
    std::string text = std::string("{\"asset\": {\"version\": \"2.0\"}, \"") + kind + "\": [{}";
    for (int i = 0; i < 3000000; ++i) text += ",{}";
    EXPECT_NE(importBad(folder.write("many.gltf", text + "]}")).find("MiB"), std::string::npos) << kind;
  }
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  EXPECT_LT(usage.ru_maxrss >> 10, 2048) << "MiB of this process, at its peak";
}

TEST(ImportHostile, ManyInstancesOfAMeshAreHeldToTheLimits) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  std::vector<float> places(3000);  // at one place they would count once
  for (size_t i = 0; i < places.size(); ++i) places[i] = static_cast<float>(i);
  file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"] =
      file.floats(places, "VEC3");
  ImportLimits limits;
  limits.max_triangles = 999;
  const auto scene = importGltf(file.save(folder, "i.glb"), limits);
  ASSERT_FALSE(scene);
  EXPECT_NE(scene.error().line().find("more than 999 triangles"), std::string::npos);
  limits.max_triangles = 1000;
  EXPECT_TRUE(importGltf(file.save(folder, "i.glb"), limits));
}

TEST(ImportHostile, RefusesRequiredExtensionsThatItDoesNotKnow) {
  expectRefusal("\"EXT_nope\" is not supported", [](GltfFile& f) { f.json["extensionsRequired"] = {"EXT_nope"}; });
}

}  // namespace
}  // namespace ff::bake
