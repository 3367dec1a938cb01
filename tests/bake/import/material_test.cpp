#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb_image_write.h>

#include <cmath>
#include <numbers>

#include "tests/bake/import/gltf_file.h"

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

TEST(ImportMaterial, EmissionIsClampedToWhatAWorldHoldsWithAWarning) {
  const TempFolder folder;
  const Scene scene = importGood(fileWith(Json::parse(R"({"emissiveFactor": [1, 1e-30, 0],
    "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 1e30}}})")).save(folder, "sun.glb"));
  EXPECT_LT(scene.materials[0].emission.x * std::numbers::pi_v<float>, formats::kMaxEmission);
  EXPECT_EQ(scene.materials[0].emission.y, 1);
  EXPECT_TRUE(warns(scene, "emission 1e+30 is clamped to 0..3e+11"));
}

TEST(ImportMaterial, SpecularGlossinessBecomesItsDiffusePart) {
  const Material m = importMaterial(Json::parse(R"({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1]},
    "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.2, 0.4, 0.6, 1]}}})"));
  EXPECT_EQ(m.base_color, (Vec3{0.2f, 0.4f, 0.6f}));
  EXPECT_EQ(m.metallic, 0.0f);
}

TEST(ImportMaterial, WhatTheMirrorTakesTheDiffusePartLacks) {
  const auto gloss = [](float specular) {
    Json m = Json::parse(R"({"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.5, 0.5, 0.5, 1]}}})");
    m["extensions"]["KHR_materials_pbrSpecularGlossiness"]["specularFactor"] = {specular, 0, 0};
    return importMaterial(m);
  };
  EXPECT_EQ(gloss(0.04f).specular, Vec3{}) << "a dielectric";
  EXPECT_EQ(gloss(0.04f).base_color.x, 0.5f);
  EXPECT_NEAR(gloss(0.52f).specular.x, 0.5f, 1e-6f);
  EXPECT_NEAR(gloss(0.52f).base_color.y, 0.25f, 1e-6f);
  EXPECT_NEAR(gloss(1).specular.x, 1, 1e-6f) << "a red metal";
  EXPECT_NEAR(gloss(1).base_color.y, 0, 1e-6f);
}

TEST(ImportMaterial, BlendStopsItsShareOfTheLight) {
  const Material m = importMaterial(Json::parse(
      R"({"alphaMode": "BLEND", "alphaCutoff": 0.9, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.25]}})"));
  EXPECT_TRUE(m.cutout && m.blend);
  EXPECT_EQ(m.alpha, 0.25f);
  EXPECT_FALSE(importMaterial(
                   Json::parse(R"({"alphaMode": "OPAQUE", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0]}})"))
                   .cutout);
}

// Energy: of unit light a share T goes into the glass and comes out tinted; the rest meets the base colour. A surface that
// stops 1 - t of it reflects base (1 - T) of the whole.
TEST(ImportMaterial, GlassLetsItsShareOfTheLightPass) {
  for (const char* extension : {R"("KHR_materials_transmission": {"transmissionFactor": 0.6})",
                                R"("KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.6,
                                   "diffuseTransmissionColorFactor": [0.5, 0.5, 0.5]})"}) {
    const Material glass = importMaterial(Json::parse(
        R"({"emissiveFactor": [1, 1, 1], "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 0]}, "extensions": {)" +
        std::string(extension) + "}}"));
    EXPECT_TRUE(glass.cutout);
    EXPECT_FALSE(glass.blend);
    EXPECT_EQ(glass.alpha_cutoff, 0) << "alphaMode OPAQUE: alpha does not count";
    EXPECT_NEAR(glass.transmission, 0.6 * 0.5, 1e-6);
    EXPECT_NEAR(glass.base_color.x * (1 - glass.transmission), 0.5 * 0.4, 1e-6);
    EXPECT_NEAR(glass.emission.x * (1 - glass.transmission), 1, 1e-6);
    EXPECT_EQ(glass.left_alone.size(), std::string(extension).find("diffuse") == std::string::npos ? 0u : 1u);
  }
  const TempFolder folder;
  const Scene clear = importGood(
      fileWith(Json::parse(R"({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}})")).save(folder, "c.glb"));
  EXPECT_TRUE(clear.triangles.empty()) << "what stops no light is not there";
}

TEST(ImportMaterial, NamesWhatIsNotModelledAndNothingElse) {
  const auto said = [](const char* extensions) {
    return importMaterial(Json::parse(R"({"extensions": {)" + std::string(extensions) + "}}")).left_alone;
  };
  for (const char* quiet :
       {R"("KHR_materials_clearcoat": {})", R"("KHR_materials_clearcoat": {"clearcoatFactor": 0})", R"("KHR_materials_ior": {"ior": 1.5})",
        R"("KHR_materials_sheen": {"sheenColorFactor": [0, 0, 0]})", R"("KHR_materials_specular": {"specularFactor": 1})",
        R"("KHR_materials_volume": {})", R"("KHR_materials_iridescence": {"iridescenceIor": 2})", R"("EXT_mesh_features": {})",
        R"("KHR_materials_emissive_strength": {"emissiveStrength": 5})", R"("KHR_materials_transmission": {"transmissionFactor": 0.5})"})
    EXPECT_TRUE(said(quiet).empty()) << quiet << ": " << said(quiet)[0];
  for (const char* loud :
       {R"("KHR_materials_clearcoat": {"clearcoatFactor": 1})", R"("KHR_materials_ior": {"ior": 2.4})",
        R"("KHR_materials_sheen": {"sheenColorFactor": [0, 0.5, 0]})", R"("KHR_materials_specular": {"specularFactor": 0})",
        R"("KHR_materials_specular": {"specularFactor": 1, "specularColorFactor": [1, 0.5, 1]})",
        R"("KHR_materials_volume": {"thicknessFactor": 0.1})", R"("KHR_materials_iridescence": {"iridescenceFactor": 1})",
        R"("KHR_materials_anisotropy": {"anisotropyStrength": 0.5})", R"("KHR_materials_unlit": {})",
        R"("KHR_materials_dispersion": {"dispersion": 0.5})", R"("ACME_materials_velvet": {})"}) {
    ASSERT_EQ(said(loud).size(), 1u) << loud;
    const std::string extension = std::string(loud).substr(1, std::string(loud).find('"', 1) - 1);
    EXPECT_EQ(said(loud)[0].compare(0, extension.size() + 1, extension + ":"), 0) << said(loud)[0];
  }
}

TEST(ImportMaterial, UnlitSurfacesReflectTheirColourAndEmitNothing) {
  const Material m = importMaterial(Json::parse(
      R"({"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0, 1]}, "extensions": {"KHR_materials_unlit": {}}})"));
  EXPECT_EQ(m.base_color, (Vec3{0.5f, 0.25f, 0}));
  EXPECT_EQ(m.metallic, 0);
  EXPECT_EQ(m.emission, Vec3{});
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

// Every way to store a colour, beside floats.
TEST(ImportMaterial, VertexColoursAreReadFromEveryKindOfAccessor) {
  const std::vector<float> rgba = {1, 0, 0.2f, 0.6f, 0.4f, 1, 0.8f, 1, 0, 0.6f, 1, 0.2f};  // fifths: exact in 8 and 16 bits
  for (const char* type : {"VEC3", "VEC4"})
    for (const int component : {5126, 5121, 5123}) {
      SCOPED_TRACE(std::string(type) + " " + std::to_string(component));
      std::vector<float> floats;
      std::vector<uint8_t> bytes;
      std::vector<uint16_t> shorts;
      for (size_t i = 0; i < rgba.size(); ++i) {
        if (i % 4 == 3 && type[3] == '3') continue;
        floats.push_back(rgba[i]);
        bytes.push_back(static_cast<uint8_t>(std::lround(rgba[i] * 255)));
        shorts.push_back(static_cast<uint16_t>(std::lround(rgba[i] * 65535)));
      }
      GltfFile file;
      file.withTriangle();
      file.primitive()["attributes"]["COLOR_0"] = component == 5126   ? file.accessor(floats, component, type)
                                                  : component == 5121 ? file.accessor(bytes, component, type, true)
                                                                      : file.accessor(shorts, component, type, true);
      const TempFolder folder;
      const Scene scene = importGood(file.save(folder, "c.glb"));
      ASSERT_EQ(scene.colors.size(), 3u);
      for (size_t v = 0; v < 3; ++v) {
        EXPECT_NEAR(scene.colors[v].r, rgba[4 * v], 1e-6f);
        EXPECT_NEAR(scene.colors[v].g, rgba[4 * v + 1], 1e-6f);
        EXPECT_NEAR(scene.colors[v].b, rgba[4 * v + 2], 1e-6f);
        EXPECT_NEAR(scene.colors[v].a, type[3] == '4' ? rgba[4 * v + 3] : 1, 1e-6f);
      }
    }
}

TEST(ImportMaterial, VertexColoursCountInTheHashAndWhiteOnesAreNone) {
  const TempFolder folder;
  std::array<uint8_t, 16> plain{};
  for (const float green : {1.0f, 0.5f, 0.25f}) {
    GltfFile file;
    file.withTriangle();
    file.primitive()["attributes"]["COLOR_0"] = file.floats({1, green, 1, 1, 1, 1, 1, 1, 1}, "VEC3");
    const Scene scene = importGood(file.save(folder, "c.glb"));
    EXPECT_EQ(scene.colors.empty(), green == 1);
    EXPECT_NE(scene.content_hash, plain);
    plain = scene.content_hash;
  }
}

}  // namespace
}  // namespace ff::bake
