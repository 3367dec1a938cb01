#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb_image_write.h>

#include <cmath>
#include <numbers>

#include "tests/bake/gltf_file.h"

namespace ff::bake {
namespace {

using Json = nlohmann::json;

// A triangle with material 0 = `material` and TEXCOORD_0 (0,0) (1,0) (0,1).
GltfFile fileWith(const Json& material) {
  GltfFile file;
  file.withTriangle();
  file.primitive()["attributes"]["TEXCOORD_0"] = file.floats({0, 0, 1, 0, 0, 1}, "VEC2");
  file.primitive()["material"] = 0;
  file.json["materials"] = {material};
  return file;
}

Material importMaterial(const Json& material) {
  const TempFolder folder;
  const Scene scene = importGood(fileWith(material).save(folder, "m.glb"));
  EXPECT_EQ(scene.triangles.size(), 1u);
  return scene.materials.empty() ? Material{} : scene.materials[scene.triangles[0].material];
}

// A 2 x 1 picture, left red and right half-transparent blue.
void writePicture(const TempFolder& folder, const char* name) {
  const uint8_t rgba[8] = {255, 0, 0, 255, 0, 0, 255, 128};
  ASSERT_NE(stbi_write_png(folder.file(name).c_str(), 2, 1, 4, rgba, 8), 0);
}

TEST(ImportMaterial, ReadsFactorsSidesAndCutouts) {
  const Material m =
      importMaterial(Json::parse(R"({"name": "brick", "doubleSided": true, "alphaMode": "MASK", "alphaCutoff": 0.25,
    "emissiveFactor": [0.5, 0.25, 0], "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 0.75], "metallicFactor": 0.5}})"));
  EXPECT_EQ(m.name, "brick");
  EXPECT_EQ(m.base_color, (Vec3{0.5f, 0.25f, 0.125f}));
  EXPECT_EQ(m.alpha, 0.75f);
  EXPECT_EQ(m.metallic, 0.5f);
  EXPECT_EQ(m.emission, (Vec3{0.5f, 0.25f, 0}));
  EXPECT_TRUE(m.double_sided);
  EXPECT_TRUE(m.cutout);
  EXPECT_EQ(m.alpha_cutoff, 0.25f);
}

TEST(ImportMaterial, EmissiveStrengthMultipliesTheFactor) {
  const Material m = importMaterial(Json::parse(R"({"emissiveFactor": [0.5, 1, 0],
    "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 40}}})"));
  EXPECT_EQ(m.emission, (Vec3{20, 40, 0}));
}

TEST(ImportMaterial, SpecularGlossinessBecomesItsDiffusePart) {
  const Material m = importMaterial(Json::parse(R"({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1]},
    "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.2, 0.4, 0.6, 1]}}})"));
  EXPECT_EQ(m.base_color, (Vec3{0.2f, 0.4f, 0.6f}));
  EXPECT_EQ(m.metallic, 0.0f);
}

TEST(ImportMaterial, BlendIsACutoutAtOneHalf) {
  const Material m = importMaterial(Json::parse(R"({"alphaMode": "BLEND", "alphaCutoff": 0.9})"));
  EXPECT_TRUE(m.cutout);
  EXPECT_EQ(m.alpha_cutoff, 0.5f);
  EXPECT_FALSE(importMaterial(
                   Json::parse(R"({"alphaMode": "OPAQUE", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0]}})"))
                   .cutout);
}

TEST(ImportMaterial, GlassLetsLightPass) {
  const Material glass =
      importMaterial(Json::parse(R"({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}})"));
  EXPECT_TRUE(glass.cutout);
  EXPECT_LT(glass.alpha, glass.alpha_cutoff);
  EXPECT_FALSE(
      importMaterial(Json::parse(R"({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.1}}})"))
          .cutout);
}

TEST(ImportMaterial, OutOfRangeFactorsAreClampedWithAWarningAndNegativeStrengthIsRefused) {
  const TempFolder folder;
  const Scene scene = importGood(
      fileWith(Json::parse(R"({"pbrMetallicRoughness": {"baseColorFactor": [7, -3, 0.5, 1]}})")).save(folder, "a.glb"));
  EXPECT_EQ(scene.materials[0].base_color, (Vec3{1, 0, 0.5f}));
  EXPECT_TRUE(warns(scene, "material 0"));
  const std::string line = importBad(
      fileWith(Json::parse(R"({"extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": -1e30}}})"))
          .save(folder, "b.glb"));
  EXPECT_NE(line.find("material 0"), std::string::npos);
}

TEST(ImportMaterial, WithoutAMaterialSurfacesAreDiffuse) {
  const TempFolder folder;
  const Scene scene = importGood(GltfFile().withTriangle().save(folder, "n.glb"));
  const Material& m = scene.materials[scene.triangles[0].material];
  EXPECT_EQ(m.metallic, 0.0f);
  EXPECT_GT(m.base_color.x, 0.5f);
  EXPECT_LT(m.base_color.x, 1.0f);
}

TEST(ImportMaterial, ReadsAPictureFromAFileAndFromABufferView) {
  const TempFolder folder;
  writePicture(folder, "red blue.png");
  const Json textured = Json::parse(R"({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})");
  GltfFile outside = fileWith(textured), inside = fileWith(textured);
  outside.json["images"] = {{{"uri", "red%20blue.png"}}};
  std::ifstream stream(folder.file("red blue.png"), std::ios::binary);
  const std::vector<char> png((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
  inside.json["images"] = {{{"bufferView", inside.view(png)}, {"mimeType", "image/png"}}};
  for (GltfFile* file : {&outside, &inside}) {
    file->json["textures"] = {{{"source", 0}}};
    const Scene scene = importGood(file->save(folder, "t.glb"));
    ASSERT_EQ(scene.images.size(), 1u);
    EXPECT_EQ(scene.images[0].width, 2u);
    EXPECT_EQ(scene.images[0].rgba, (std::vector<uint8_t>{255, 0, 0, 255, 0, 0, 255, 128}));
    EXPECT_EQ(scene.materials[0].base_image, 0u);
    EXPECT_EQ(scene.uv0.size(), 3u);
    EXPECT_TRUE(scene.uv1.empty());
    EXPECT_TRUE(scene.warnings.empty());
  }
}

TEST(ImportMaterial, AMissingOrBrokenPictureIsAWarningAndTheFactorStands) {
  const TempFolder folder;
  folder.write("broken.png", std::string("\x89PNG\r\n\x1a\n", 8) + "no more");
  for (const char* uri :
       {"nowhere.png", "broken.png", "http://127.0.0.1:9/x.png", "../../etc/passwd", "data:image/png;base64,////"}) {
    GltfFile file = fileWith(Json::parse(
        R"({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.5, 0.5, 1]}})"));
    file.json["images"] = {{{"uri", uri}}};
    file.json["textures"] = {{{"source", 0}}};
    const Scene scene = importGood(file.save(folder, "t.gltf"));
    EXPECT_TRUE(scene.images.empty()) << uri;
    EXPECT_EQ(scene.materials[0].base_image, kNone);
    EXPECT_EQ(scene.materials[0].base_color.x, 0.5f);
    EXPECT_TRUE(warns(scene, "image 0")) << uri;
  }
}

TEST(ImportMaterial, APictureLargerThanTheMemoryLimitIsAWarning) {
  const TempFolder folder;
  const std::vector<uint8_t> black(size_t{2000} * 2000 * 4);
  ASSERT_NE(stbi_write_png(folder.file("black.png").c_str(), 2000, 2000, 4, black.data(), 8000), 0);
  GltfFile file = fileWith(Json::parse(R"({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})"));
  file.json["images"] = {{{"uri", "black.png"}}};
  file.json["textures"] = {{{"source", 0}}};
  ImportLimits limits;
  limits.max_memory_bytes = 4 << 20;
  const auto scene = importGltf(file.save(folder, "t.gltf"), limits);
  ASSERT_TRUE(scene) << scene.error().line();
  EXPECT_TRUE(warns(*scene, "MiB"));
}

TEST(ImportMaterial, TheMeanOfTheMetalPictureScalesMetalness) {
  const TempFolder folder;
  writePicture(folder, "metal.png");  // blue: 0 and 255
  GltfFile file = fileWith(Json::parse(R"({"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}}})"));
  file.json["images"] = {{{"uri", "metal.png"}}};
  file.json["textures"] = {{{"source", 0}}};
  EXPECT_NEAR(importGood(file.save(folder, "m.gltf")).materials[0].metallic, 0.5f, 1e-6f);
}

TEST(ImportMaterial, TextureTransformAndSetAreAppliedToBaseAndEmissionEach) {
  const TempFolder folder;
  writePicture(folder, "p.png");
  Json material = Json::parse(R"({"emissiveFactor": [1, 1, 1],
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform":
        {"offset": [0.25, 0.5], "scale": [2, 4], "texCoord": 1}}}},
    "emissiveTexture": {"index": 0, "extensions": {"KHR_texture_transform": {}}}})");
  material["emissiveTexture"]["extensions"]["KHR_texture_transform"]["rotation"] = std::numbers::pi / 2;
  GltfFile file = fileWith(material);
  file.primitive()["attributes"]["TEXCOORD_1"] =
      file.accessor(std::vector<uint16_t>{0, 0, 65535, 0, 0, 65535}, 5123, "VEC2", true);
  file.json["images"] = {{{"uri", "p.png"}}};
  file.json["textures"] = {{{"source", 0}, {"sampler", 0}}};
  file.json["samplers"] = {{{"wrapS", 33071}, {"wrapT", 33071}}};
  const Scene scene = importGood(file.save(folder, "t.gltf"));
  EXPECT_FALSE(scene.materials[0].repeat);
  EXPECT_EQ(scene.images.size(), 1u) << "one picture, shown twice";
  const auto& v = scene.triangles[0].v;
  EXPECT_NEAR(scene.uv0[v[1]].x, 2.25f, 1e-6f);
  EXPECT_NEAR(scene.uv0[v[2]].y, 4.5f, 1e-6f);
  // A quarter turn counter-clockwise as seen with v downwards takes (1, 0) to (0, -1) and (0, 1) to (1, 0).
  EXPECT_NEAR(scene.uv1[v[1]].x, 0, 1e-6f);
  EXPECT_NEAR(scene.uv1[v[1]].y, -1, 1e-6f);
  EXPECT_NEAR(scene.uv1[v[2]].x, 1, 1e-6f);
}

TEST(ImportMaterial, ATextureWithoutItsCoordinatesIsRefused) {
  const TempFolder folder;
  GltfFile file =
      fileWith(Json::parse(R"({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}})"));
  file.json["images"] = {{{"uri", "p.png"}}};
  file.json["textures"] = {{{"source", 0}}};
  EXPECT_NE(importBad(file.save(folder, "t.gltf")).find("TEXCOORD_1"), std::string::npos);
}

TEST(ImportMaterial, VertexColoursTintTheMaterialTriangleByTriangle) {
  const TempFolder folder;
  GltfFile file;
  file.primitive()["attributes"]["POSITION"] =
      file.floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 0, 1, 1}, "VEC3");
  file.primitive()["attributes"]["COLOR_0"] =
      file.accessor(std::vector<uint8_t>{255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255,
                                         64,  0,   0,   255, 64,  0,   0,   255, 64,  0,   0,   255},
                    5121, "VEC4", true);
  file.json["materials"] =
      Json::parse(R"([{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0}}])");
  file.primitive()["material"] = 0;
  const Scene scene = importGood(file.save(folder, "c.glb"));
  ASSERT_EQ(scene.triangles.size(), 2u);
  EXPECT_EQ(scene.materials[scene.triangles[0].material].base_color, (Vec3{0.5f, 0.5f, 0.5f}));
  const Vec3 tint = scene.materials[scene.triangles[1].material].base_color;
  // sqrt(64/255) = 0.501; steps of 1/15 in the square root: off by at most 2 * 0.501 / 30 + 1/900 of the factor.
  EXPECT_NEAR(tint.x, 0.5 * 64 / 255, 0.5 * 0.035);
  EXPECT_EQ(tint.y, 0.0f);
}

}  // namespace
}  // namespace ff::bake
