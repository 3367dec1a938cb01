#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>

#include <cmath>
#include <random>

#ifdef FF_HAVE_MESHOPTIMIZER
#include <meshoptimizer.h>
#endif

#include "bake/import/meshopt_vertices.h"
#include "tests/bake/import/gltf_file.h"

namespace ff::bake {
namespace {

TEST(Import, ReadsATriangleFromGltfWithABufferFileFromGlbAndFromADataUri) {
  const TempFolder folder;
  const Scene from_file = importGood(GltfFile().withTriangle().save(folder, "a.gltf"));
  const Scene from_glb = importGood(GltfFile().withTriangle().save(folder, "a.glb"));
  GltfFile embedded;
  embedded.withTriangle();
  // (0,0,0), (1,0,0), (0,1,0) as little-endian floats.
  embedded.json["buffers"] = {
      {{"byteLength", 36},
       {"uri", "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}}};
  const Scene from_uri = importGood(embedded.save(folder, "b.gltf"));
  for (const Scene* scene : {&from_file, &from_glb, &from_uri}) {
    ASSERT_EQ(scene->triangles.size(), 1u);
    expectNear(areaVector(*scene, 0), {0, 0, 1});
    EXPECT_EQ(scene->content_hash, from_file.content_hash);
  }
  EXPECT_EQ(from_glb.name, "a.glb");
}

TEST(Import, ScaleAndUpTurnAFileToMetresWithYUp) {
  const TempFolder folder;
  GltfFile file;
  file.primitive()["attributes"]["POSITION"] = file.floats({0, 0, 0, 100, 0, 0, 0, 0, 200}, "VEC3");
  const auto scene = importGltf(file.save(folder, "z.glb"), {.scale = 0.01, .z_up = true});
  ASSERT_TRUE(scene) << scene.error().line();
  expectNear(corner(*scene, 0, 1), {1, 0, 0});
  expectNear(corner(*scene, 0, 2), {0, 2, 0});  // what pointed up still does
  EXPECT_FALSE(importGltf(file.save(folder, "z.glb"), {.scale = 0}));
}

TEST(Import, InstancesAtOnePlaceCountOnceAndAreNamed) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  file.json["meshes"][0]["name"] = "bulb";
  file.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"name", "lamp 2"}}, {{"mesh", 0}, {"translation", {1, 0, 0}}}};
  file.json["scenes"][0]["nodes"] = {0, 1, 2};
  const Scene scene = importGood(file.save(folder, "a.glb"));
  EXPECT_EQ(scene.triangles.size(), 2u);
  EXPECT_TRUE(warns(scene, "1 instance stands where another does and counts once: 1 of mesh \"bulb\" (first: node \"lamp 2\")"));
}

TEST(Import, InstancesAtOnePlaceAreSaidInOneLineTheCommonestFirst) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  const auto mesh = file.json["meshes"][0];
  file.json["nodes"] = file.json["scenes"][0]["nodes"] = nlohmann::json::array();
  for (size_t m = 0; m < 6; ++m) {
    file.json["meshes"][m] = mesh;
    if (m < 2) file.json["meshes"][m]["name"] = "lamp";
    for (size_t i = 0; i < (m == 5 ? 1 : m + 2); ++i) {  // mesh 5 is there once; a node that is left out is no repeat
      file.json["scenes"][0]["nodes"].push_back(file.json["nodes"].size());
      file.json["nodes"].push_back({{"mesh", m}, {"translation", {m, 0, 0}}});
    }
    file.json["scenes"][0]["nodes"].push_back(file.json["nodes"].size());
    file.json["nodes"].push_back({{"mesh", m}, {"translation", {m, 0, 0}}, {"extras", {{"formfield", {{"include", false}}}}}});
  }
  const Scene scene = importGood(file.save(folder, "a.glb"));
  EXPECT_EQ(scene.triangles.size(), 6u);
  ASSERT_EQ(std::count_if(scene.warnings.begin(), scene.warnings.end(), [](const std::string& w) { return w.find("instances") != std::string::npos; }), 1);
  EXPECT_TRUE(warns(scene, "15 instances stand where others do and count once: 5 of mesh 4 (first: node 19), 4 of mesh 3 (first: node 13), "
                           "3 of mesh \"lamp\" (first: node 1) and those of 1 more mesh"));
}

TEST(Import, ExtrasLeaveOutOccludeAndNameLampsAndChildrenInheritThem) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  file.json["materials"] = {{{"name", "white"}, {"emissiveFactor", {1, 1, 1}}}};
  file.primitive()["material"] = 0;
  const auto ours = [](GltfFile::Json what) { return GltfFile::Json{{"formfield", std::move(what)}}; };
  file.json["nodes"] = {{{"children", {1, 2}}, {"extras", ours({{"lamp", "street"}})}},
                        {{"mesh", 0}},
                        {{"mesh", 0}, {"translation", {1, 0, 0}}, {"extras", ours({{"lamp", "door"}, {"occlude_only", true}})}},
                        {{"mesh", 0}, {"translation", {2, 0, 0}}, {"extras", ours({{"include", false}})}},
                        {{"mesh", 0}, {"translation", {3, 0, 0}}, {"extras", "a text of someone else's"}}};
  file.json["scenes"][0]["nodes"] = {0, 3, 4};
  const Scene scene = importGood(file.save(folder, "a.glb"));
  ASSERT_EQ(scene.triangles.size(), 3u);
  const auto material = [&](size_t t) { return scene.materials[scene.triangles[t].material]; };
  EXPECT_EQ(material(0).lamp_group, "street");
  EXPECT_FALSE(material(0).occlude_only);
  EXPECT_EQ(material(1).lamp_group, "door");
  EXPECT_TRUE(material(1).occlude_only);
  EXPECT_EQ(material(2).lamp_group, "");
  file.json["nodes"][4]["extras"] = ours({{"exclude", true}});
  EXPECT_NE(importBad(file.save(folder, "b.glb")).find("\"exclude\" is unknown"), std::string::npos);
}

TEST(Import, ASceneFarAwayKeepsItsShape) {
  const TempFolder folder;
  const auto at = [&](double x, const char* name) {
    GltfFile file;
    file.withTriangle();
    file.json["nodes"][0]["translation"] = {x, 0, -x};
    return importGood(file.save(folder, name));
  };
  const Scene here = at(0, "a.glb"), near = at(3, "b.glb"), far = at(1e6 + 0.5, "c.glb");
  EXPECT_EQ(near.origin, here.origin);
  expectNear(areaVector(far, 0), areaVector(here, 0), 1e-6f);  // in float alone the corners would be 1/16 m apart or nothing
  for (int a = 0; a < 3; ++a)
    EXPECT_NEAR(far.origin[static_cast<size_t>(a)] + static_cast<double>(corner(far, 0, 0)[a]), a == 0 ? 1e6 + 0.5 : a == 1 ? 0 : -1e6 - 0.5, 1e-6);
}

TEST(Import, ContentHashChangesWithACoordinateAndAMaterialButNotWithANodeName) {
  const TempFolder folder;
  const auto hash = [&](const char* name, auto&& edit) {
    GltfFile file;
    file.withTriangle();
    file.json["materials"] = {{{"pbrMetallicRoughness", {{"metallicFactor", 0}}}}};
    file.primitive()["material"] = 0;
    edit(file);
    return importGood(file.save(folder, name)).content_hash;
  };
  const auto plain = hash("0.glb", [](GltfFile&) {});
  EXPECT_EQ(plain, hash("1.glb", [](GltfFile& f) { f.json["nodes"][0]["name"] = "n"; }));
  EXPECT_NE(plain, hash("2.glb", [](GltfFile& f) { f.json["nodes"][0]["translation"] = {0, 0, 1}; }));
  EXPECT_NE(plain, hash("3.glb", [](GltfFile& f) { f.json["materials"][0]["doubleSided"] = true; }));
}

TEST(Import, StripsAndFansGiveTheTrianglesOfTheSpecificationWithTheirWinding) {
  const TempFolder folder;
  // A zigzag over the unit square, and a fan around its first corner: each two triangles facing +z.
  for (const auto& [mode, positions] : {std::pair{5, std::vector<float>{0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0}},
                                        std::pair{6, std::vector<float>{0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0}}}) {
    GltfFile file;
    file.primitive()["attributes"]["POSITION"] = file.floats(positions, "VEC3");
    file.primitive()["mode"] = mode;
    const Scene scene = importGood(file.save(folder, "m.glb"));
    ASSERT_EQ(scene.triangles.size(), 2u);
    expectNear(areaVector(scene, 0), {0, 0, 1});
    expectNear(areaVector(scene, 1), {0, 0, 1});
  }
}

TEST(Import, IndicesOfOneTwoAndFourBytesGiveTheSameScene) {
  const TempFolder folder;
  const auto load = [&](const char* name, auto zero, int component_type) {
    using T = decltype(zero);
    GltfFile file;
    file.primitive()["attributes"]["POSITION"] = file.floats({9, 9, 9, 0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
    file.primitive()["indices"] = file.accessor(std::vector<T>{1, 2, 3}, component_type, "SCALAR");
    return importGood(file.save(folder, name));
  };
  const Scene bytes = load("1.glb", uint8_t{0}, 5121);
  EXPECT_EQ(bytes.positions.size(), 3u) << "the vertex that nothing uses is not kept";
  expectNear(areaVector(bytes, 0), {0, 0, 1});
  EXPECT_EQ(bytes.content_hash, load("2.glb", uint16_t{0}, 5123).content_hash);
  EXPECT_EQ(bytes.content_hash, load("4.glb", uint32_t{0}, 5125).content_hash);
}

TEST(Import, NodesOfOneMeshBecomeInstancesUnderTheirParentsTransforms) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  const float half = std::sqrt(0.5f);
  file.json["nodes"] = {{{"children", {1, 2}}, {"translation", {10, 0, 0}}},
                        {{"mesh", 0}, {"rotation", {0, 0, half, half}}, {"scale", {2, 2, 2}}},  // 90 degrees about z
                        {{"mesh", 0}, {"matrix", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1}}}};
  const Scene scene = importGood(file.save(folder, "n.glb"));
  ASSERT_EQ(scene.triangles.size(), 2u);
  expectNear(corner(scene, 0, 1), {10, 2, 0}, 1e-5f);  // (1,0,0) -> scaled, turned, moved
  expectNear(corner(scene, 0, 2), {8, 0, 0}, 1e-5f);
  expectNear(corner(scene, 1, 2), {10, 6, 0});
}

TEST(Import, AMirroredNodeKeepsItsFrontOutside) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  file.json["nodes"][0]["scale"] = {-1, 1, 1};
  const Scene scene = importGood(file.save(folder, "m.glb"));
  expectNear(areaVector(scene, 0), {0, 0, 1});
  EXPECT_LT(std::min(corner(scene, 0, 1).x, corner(scene, 0, 2).x), -0.9f);
}

TEST(Import, GpuInstancingMultipliesAMeshBeforeItsNode) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  file.json["nodes"][0]["translation"] = {0, 0, 7};
  file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {
      {"TRANSLATION", file.floats({0, 0, 0, 3, 0, 0}, "VEC3")},
      {"ROTATION", file.accessor(std::vector<int8_t>{0, 0, 0, 127, 0, 0, 127, 0}, 5120, "VEC4",
                                 true)},  // none, 180 degrees about z
      {"SCALE", file.floats({1, 1, 1, 2, 2, 2}, "VEC3")}};
  file.json["extensionsRequired"] = {"EXT_mesh_gpu_instancing"};
  const Scene scene = importGood(file.save(folder, "i.glb"));
  ASSERT_EQ(scene.triangles.size(), 2u);
  expectNear(corner(scene, 0, 1), {1, 0, 7});
  expectNear(corner(scene, 1, 1), {1, 0, 7}, 1e-5f);  // 3 - 2
  expectNear(corner(scene, 1, 2), {3, -2, 7}, 1e-5f);
}

TEST(Import, SparseAccessorsReplaceElementsOfABaseAndOfZeros) {
  const TempFolder folder;
  GltfFile with_base, without;
  const auto sparse = [](GltfFile& f, int accessor) {
    f.json["accessors"][static_cast<size_t>(accessor)]["sparse"] = {
        {"count", 2},
        {"indices", {{"bufferView", f.view(std::vector<uint16_t>{1, 2})}, {"componentType", 5123}}},
        {"values", {{"bufferView", f.view(std::vector<float>{3, 0, 0, 0, 3, 0})}}}};
    f.primitive()["attributes"]["POSITION"] = accessor;
  };
  sparse(with_base, with_base.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3"));
  without.json["accessors"].push_back({{"componentType", 5126}, {"type", "VEC3"}, {"count", 3}});
  sparse(without, 0);
  for (GltfFile* file : {&with_base, &without})
    expectNear(areaVector(importGood(file->save(folder, "s.glb")), 0), {0, 0, 9});
}

TEST(Import, QuantisedPositionsAreNormalisedAsTheSpecificationSays) {
  const TempFolder folder;
  GltfFile file;
  // 4-byte stride for three bytes of position.
  file.primitive()["attributes"]["POSITION"] =
      file.accessor(std::vector<int8_t>{0, 0, 0, 0, 127, 0, 0, 0, -128, 127, 0, 0}, 5120, "VEC3", true);
  file.json["accessors"][0]["count"] = 3;
  file.json["bufferViews"][0]["byteStride"] = 4;
  file.json["extensionsUsed"] = file.json["extensionsRequired"] = {"KHR_mesh_quantization"};
  const Scene scene = importGood(file.save(folder, "q.glb"));
  expectNear(corner(scene, 0, 1), {1, 0, 0});
  expectNear(corner(scene, 0, 2), {-1, 1, 0});  // -128 / 127 is clamped
  file.json.erase("extensionsUsed");
  file.json.erase("extensionsRequired");
  EXPECT_NE(importBad(file.save(folder, "q2.glb")).find("POSITION: accessor 0"), std::string::npos);
}

TEST(Import, TrianglesWithoutAreaAreDroppedAndCounted) {
  const TempFolder folder;
  GltfFile file;
  file.primitive()["attributes"]["POSITION"] =
      file.floats({0, 0, 0,    1, 0, 0,    0, 1, 0, /* a point */ 1, 1, 1, 1, 1, 1, 1, 1, 1, /* a line */ 0.1f,
                   0, 0, 0.2f, 0, 0, 0.3f, 0, 0},
                  "VEC3");
  const Scene scene = importGood(file.save(folder, "d.glb"));
  EXPECT_EQ(scene.triangles.size(), 1u);
  EXPECT_EQ(scene.without_area, 2u);
  ASSERT_EQ(scene.without_area_at.size(), 2u);
  EXPECT_EQ(scene.without_area_at[0].at, (std::array<double, 3>{1, 1, 1}));
}

TEST(Import, WithoutScenesEveryRootIsLoaded) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  file.json.erase("scene");
  file.json.erase("scenes");
  file.json["nodes"] = {{{"mesh", 0}}, {{"children", {2}}}, {{"mesh", 0}, {"translation", {0, 0, 1}}}};
  EXPECT_EQ(importGood(file.save(folder, "r.glb")).triangles.size(), 2u);
}

TEST(Import, AChainOfFiftyThousandNodesLoads) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle();
  constexpr size_t kNodes = 50000;
  for (size_t i = 0; i + 1 < kNodes; ++i) file.json["nodes"][i] = {{"children", {i + 1}}};
  file.json["nodes"][kNodes - 1] = {{"mesh", 0}};
  EXPECT_EQ(importGood(file.save(folder, "c.glb")).triangles.size(), 1u);
}

TEST(Import, PointsAndLinesAreLeftOutWithAWarning) {
  const TempFolder folder;
  GltfFile file;
  file.withTriangle().primitive()["mode"] = 0;
  const Scene scene = importGood(file.save(folder, "p.glb"));
  EXPECT_TRUE(scene.triangles.empty());
  EXPECT_TRUE(warns(scene, "points or lines"));
  EXPECT_TRUE(warns(scene, "no triangles"));
}

// A Draco grid of n x n cells in the unit square, unquantised, with texture coordinates equal to x, y.
struct DracoGrid {
  std::string bytes;
  size_t vertices = 0, triangles = 0;
  int position_id = 0, uv_id = 0;
};

// more: attributes of four integers that nobody asks for.
DracoGrid encodeGrid(int n, int method, int more = 0) {
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(2 * n * n);
  const int position = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  const int uv = builder.AddAttribute(draco::GeometryAttribute::TEX_COORD, 2, draco::DT_FLOAT32);
  const auto step = 1.0f / static_cast<float>(n);
  for (int i = 0; i < 2 * n * n; ++i) {
    const float x = static_cast<float>(i / 2 % n) * step, y = static_cast<float>(i / 2 / n) * step;
    const std::array<std::array<float, 3>, 4> c = {
        {{x, y, 0}, {x + step, y, 0}, {x + step, y + step, 0}, {x, y + step, 0}}};
    const std::array<size_t, 3> pick = i % 2 ? std::array<size_t, 3>{0, 2, 3} : std::array<size_t, 3>{0, 1, 2};
    const auto face = draco::FaceIndex(static_cast<uint32_t>(i));
    builder.SetAttributeValuesForFace(position, face, c[pick[0]].data(), c[pick[1]].data(), c[pick[2]].data());
    builder.SetAttributeValuesForFace(uv, face, c[pick[0]].data(), c[pick[1]].data(), c[pick[2]].data());
  }
  for (int k = 0; k < more; ++k) {
    const int attribute = builder.AddAttribute(draco::GeometryAttribute::GENERIC, 4, draco::DT_INT32);
    const std::array<int32_t, 4> none{};
    for (int i = 0; i < 2 * n * n; ++i)
      builder.SetAttributeValuesForFace(attribute, draco::FaceIndex(static_cast<uint32_t>(i)), none.data(), none.data(), none.data());
  }
  const auto mesh = builder.Finalize();
  draco::Encoder encoder;
  encoder.SetEncodingMethod(method);
  draco::EncoderBuffer buffer;
  EXPECT_TRUE(encoder.EncodeMeshToBuffer(*mesh, &buffer).ok());
  DracoGrid out;
  out.bytes.assign(buffer.data(), buffer.size());
  out.vertices = mesh->num_points();
  out.triangles = mesh->num_faces();
  out.position_id = static_cast<int>(mesh->attribute(position)->unique_id());
  out.uv_id = static_cast<int>(mesh->attribute(uv)->unique_id());
  return out;
}

GltfFile dracoFile(const DracoGrid& grid) {
  GltfFile file;
  file.json["accessors"] = {{{"componentType", 5126}, {"type", "VEC3"}, {"count", grid.vertices}},
                            {{"componentType", 5125}, {"type", "SCALAR"}, {"count", grid.triangles * 3}},
                            {{"componentType", 5126}, {"type", "VEC2"}, {"count", grid.vertices}}};
  file.primitive()["attributes"] = {{"POSITION", 0}, {"TEXCOORD_0", 2}};
  file.primitive()["indices"] = 1;
  file.primitive()["extensions"]["KHR_draco_mesh_compression"] = {
      {"bufferView", file.view(std::vector<char>(grid.bytes.begin(), grid.bytes.end()))},
      {"attributes", {{"POSITION", grid.position_id}, {"TEXCOORD_0", grid.uv_id}}}};
  file.json["extensionsRequired"] = {"KHR_draco_mesh_compression"};
  return file;
}

TEST(Import, DecodesDracoMeshesOfBothMethods) {
  const TempFolder folder;
  for (const int method : {draco::MESH_EDGEBREAKER_ENCODING, draco::MESH_SEQUENTIAL_ENCODING}) {
    GltfFile file = dracoFile(encodeGrid(5, method));
    const Scene scene = importGood(file.save(folder, "d.glb"));
    ASSERT_EQ(scene.triangles.size(), 50u);
    Vec3 sum;
    for (size_t t = 0; t < 50; ++t) sum += areaVector(scene, t);
    expectNear(sum, {0, 0, 2}, 1e-5f);
  }
}

// Such attributes compress to next to nothing, and Draco would take memory for each of their values.
TEST(Import, DracoAttributesThatNobodyAsksForStayWithinTheMemoryLimit) {
  const TempFolder folder;
  const ImportLimits limits{.max_memory_bytes = 4 << 20};
  for (const int method : {draco::MESH_EDGEBREAKER_ENCODING, draco::MESH_SEQUENTIAL_ENCODING})
    for (const int more : {0, 100}) {
      GltfFile file = dracoFile(encodeGrid(40, method, more));
      const auto scene = importGltf(file.save(folder, "d.glb"), limits);
      ASSERT_EQ(scene.has_value(), more == 0);
      if (more > 0) {
        EXPECT_NE(scene.error().line().find("the limit is 4 MiB"), std::string::npos) << scene.error().line();
      }
    }
}

// Colours that tell where a vertex is: red x, green y; as floats, bytes and words, with alpha or without, called normalised by Draco's
// own flag as well or by the accessor alone.
TEST(Import, ReadsVertexColoursFromDracoData) {
  const TempFolder folder;
  const auto encode = [](auto one, draco::DataType type, int channels, bool flagged) {
    using T = decltype(one);
    draco::TriangleSoupMeshBuilder builder;
    builder.Start(2);
    const int position = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
    const int color = builder.AddAttribute(draco::GeometryAttribute::COLOR, static_cast<int8_t>(channels), type, flagged);
    const std::array<std::array<float, 3>, 4> c = {{{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}};
    for (uint32_t f = 0; f < 2; ++f) {
      std::array<std::array<T, 4>, 3> colors;
      const std::array<size_t, 3> pick = f ? std::array<size_t, 3>{0, 2, 3} : std::array<size_t, 3>{0, 1, 2};
      for (size_t k = 0; k < 3; ++k)
        colors[k] = {static_cast<T>(c[pick[k]][0] * static_cast<float>(one)), static_cast<T>(c[pick[k]][1] * static_cast<float>(one)), one,
                     static_cast<T>(static_cast<float>(one) * 0.2f)};
      builder.SetAttributeValuesForFace(position, draco::FaceIndex(f), c[pick[0]].data(), c[pick[1]].data(), c[pick[2]].data());
      builder.SetAttributeValuesForFace(color, draco::FaceIndex(f), colors[0].data(), colors[1].data(), colors[2].data());
    }
    const auto mesh = builder.Finalize();
    draco::EncoderBuffer buffer;
    EXPECT_TRUE(draco::Encoder().EncodeMeshToBuffer(*mesh, &buffer).ok());
    DracoGrid grid{{buffer.data(), buffer.size()}, mesh->num_points(), mesh->num_faces(),
                   static_cast<int>(mesh->attribute(position)->unique_id()), static_cast<int>(mesh->attribute(color)->unique_id())};
    GltfFile file = dracoFile(grid);
    auto& attributes = file.primitive()["extensions"]["KHR_draco_mesh_compression"]["attributes"];
    file.primitive()["attributes"] = {{"POSITION", 0}, {"COLOR_0", 2}};
    attributes = {{"POSITION", grid.position_id}, {"COLOR_0", grid.uv_id}};
    auto& accessor = file.json["accessors"][2];
    accessor["type"] = "VEC" + std::to_string(channels);
    accessor["componentType"] = type == draco::DT_FLOAT32 ? 5126 : type == draco::DT_UINT8 ? 5121 : 5123;
    if (std::is_integral_v<T>) accessor["normalized"] = true;
    return file;
  };
  for (const int channels : {3, 4})
    for (GltfFile& file : std::array{encode(1.0f, draco::DT_FLOAT32, channels, false), encode(uint8_t{255}, draco::DT_UINT8, channels, true),
                                     encode(uint8_t{255}, draco::DT_UINT8, channels, false), encode(uint16_t{65535}, draco::DT_UINT16, channels, false)}) {
      const Scene scene = importGood(file.save(folder, "c.glb"));
      ASSERT_EQ(scene.triangles.size(), 2u);
      ASSERT_EQ(scene.colors.size(), scene.positions.size());
      for (size_t v = 0; v < scene.positions.size(); ++v) {
        const Rgba& c = scene.colors[v];
        expectNear(c.rgb(), {scene.positions[v].x, scene.positions[v].y, 1}, 1e-6f);
        EXPECT_NEAR(c.a, channels == 4 ? 0.2f : 1, 1e-5f);
      }
    }
}

TEST(Import, RefusesDracoDataCutAtEveryLength) {
  const TempFolder folder;
  const DracoGrid whole = encodeGrid(4, draco::MESH_EDGEBREAKER_ENCODING);
  for (size_t n = 0; n < whole.bytes.size(); ++n) {
    DracoGrid cut = whole;
    cut.bytes.resize(n);
    if (n == 0) cut.bytes = " ";  // a bufferView of no bytes is a fault of its own
    EXPECT_NE(importBad(dracoFile(cut).save(folder, "c.glb")).find("mesh 0 primitive 0"), std::string::npos);
  }
}

TEST(Import, NamesWhatDoesNotFitTheDracoData) {
  const TempFolder folder;
  const DracoGrid grid = encodeGrid(4, draco::MESH_EDGEBREAKER_ENCODING);
  const auto refusal = [&](const char* pointer, int value) {
    GltfFile file = dracoFile(grid);
    file.json[nlohmann::json::json_pointer(pointer)] = value;
    return importBad(file.save(folder, "d.glb"));
  };
  const std::string draco = "/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression/";
  EXPECT_NE(refusal((draco + "attributes/POSITION").c_str(), 77).find("no attribute with id 77"), std::string::npos);
  EXPECT_NE(refusal((draco + "bufferView").c_str(), 9).find("bufferView 9"), std::string::npos);
  EXPECT_NE(refusal("/accessors/1/count", 3000000).find("3000000"), std::string::npos);
  EXPECT_NE(refusal("/accessors/1/count", 99).find("99"), std::string::npos);
}

#ifdef FF_HAVE_MESHOPTIMIZER
std::vector<uint8_t> encodeVertices(const std::vector<uint8_t>& vertices, size_t stride) {
  std::vector<uint8_t> out(meshopt_encodeVertexBufferBound(vertices.size() / stride, stride));
  out.resize(meshopt_encodeVertexBuffer(out.data(), out.size(), vertices.data(), vertices.size() / stride, stride));
  return out;
}

TEST(ImportMeshopt, AttributeStreamsDecodeToWhatTheLibraryEncoded) {
  std::mt19937 random(7);
  for (const size_t stride : {4, 8, 12, 64, 256})
    for (const size_t count : {1, 15, 16, 17, 256, 257, 1000})
      for (const int range : {1, 4, 20, 256}) {  // of the steps between elements: every width of code
        std::vector<uint8_t> vertices(stride * count);
        for (size_t i = 0; i < vertices.size(); ++i)
          vertices[i] = static_cast<uint8_t>((i < stride ? 0 : vertices[i - stride]) +
                                             static_cast<int>(random() % static_cast<unsigned>(range)));
        const auto stream = encodeVertices(vertices, stride);
        std::vector<uint8_t> decoded(vertices.size());
        ASSERT_TRUE(gltf::decodeMeshoptVertices(stream, stride, decoded)) << stride << ' ' << count << ' ' << range;
        EXPECT_EQ(decoded, vertices);
        for (size_t n = 0; n < stream.size() && stream.size() < 2000; ++n)
          EXPECT_FALSE(gltf::decodeMeshoptVertices(std::span(stream).first(n), stride, decoded)) << "cut at " << n;
      }
}

TEST(ImportMeshopt, ReadsACompressedMeshWithoutItsFallbackBuffer) {
  const TempFolder folder;
  GltfFile file;
  const std::vector<float> corners = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  std::vector<uint8_t> raw(sizeof(float) * corners.size());
  std::memcpy(raw.data(), corners.data(), raw.size());
  const std::vector<uint32_t> indices = {0, 1, 2};
  std::vector<uint8_t> triangles(meshopt_encodeIndexBufferBound(3, 3));
  meshopt_encodeIndexVersion(1);
  triangles.resize(meshopt_encodeIndexBuffer(triangles.data(), triangles.size(), indices.data(), 3));
  const std::vector<uint8_t> vertices = encodeVertices(raw, 12);
  const int first = file.view(vertices), second = file.view(triangles);
  const auto compressed = [&](int view, const std::vector<uint8_t>& stream, const char* mode, int stride, int bytes) {
    auto& json = file.json["bufferViews"][static_cast<size_t>(view)];
    json["extensions"]["EXT_meshopt_compression"] = {{"buffer", 0},
                                                     {"byteOffset", json["byteOffset"]},
                                                     {"byteLength", stream.size()},
                                                     {"byteStride", stride},
                                                     {"count", 3},
                                                     {"mode", mode}};
    json["buffer"] = 1;
    json["byteOffset"] = 0;
    json["byteLength"] = bytes;
  };
  compressed(first, vertices, "ATTRIBUTES", 12, 36);
  compressed(second, triangles, "TRIANGLES", 2, 6);
  file.json["accessors"] = {{{"bufferView", first}, {"componentType", 5126}, {"type", "VEC3"}, {"count", 3}},
                            {{"bufferView", second}, {"componentType", 5123}, {"type", "SCALAR"}, {"count", 3}}};
  file.primitive()["attributes"]["POSITION"] = 0;
  file.primitive()["indices"] = 1;
  while (file.bytes.size() % 4) file.bytes += '\0';
  file.json["buffers"] = {{{"byteLength", file.bytes.size()}},
                          {{"byteLength", 36}, {"extensions", {{"EXT_meshopt_compression", {{"fallback", true}}}}}}};
  const Scene scene = importGood(file.save(folder, "m.glb"));
  ASSERT_EQ(scene.triangles.size(), 1u);
  expectNear(areaVector(scene, 0), {0, 0, 1});
}
#endif

}  // namespace
}  // namespace ff::bake
