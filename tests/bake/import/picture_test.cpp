// Pictures: formats, faults, stand-ins; each is read once.
#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
#include <stb_image_write.h>
#include <turbojpeg.h>
#include <webp/encode.h>

#include <ctime>
#include <cstdlib>

#include "tests/bake/import/gltf_file.h"

namespace ff::bake {
namespace {

using Json = nlohmann::json;
using Bytes = std::vector<uint8_t>;

const std::filesystem::path kHostile =
    std::filesystem::path(std::getenv("FF_SHARED_SCENES") ? std::getenv("FF_SHARED_SCENES") : FF_SHARED_SCENES) / "hostile";

// A textured triangle with textures[0] = `texture`.
GltfFile fileWith(const Json& texture, const char* mode = "OPAQUE") {
  GltfFile file;
  file.withTriangle();
  file.primitive()["attributes"]["TEXCOORD_0"] = file.floats({0, 0, 1, 0, 0, 1}, "VEC2");
  file.primitive()["material"] = 0;
  file.json["materials"] = {Json::parse(R"({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0}})")};
  file.json["materials"][0]["alphaMode"] = mode;
  file.json["textures"] = {texture};
  return file;
}

void addImage(GltfFile& file, const Bytes& bytes, const char* mime = "") {
  Json image = {{"bufferView", file.view(bytes)}};
  if (*mime) image["mimeType"] = mime;
  file.json["images"].push_back(std::move(image));
}

void append(void* to, void* data, int size) {
  const auto* p = static_cast<const uint8_t*>(data);
  static_cast<Bytes*>(to)->insert(static_cast<Bytes*>(to)->end(), p, p + size);
}

// 16 x 16, left half red, right half half-transparent blue.
Bytes pixels() {
  Bytes rgba;
  for (int i = 0; i < 256; ++i)
    for (const int v : i % 16 < 8 ? std::array{255, 0, 0, 255} : std::array{0, 0, 255, 128}) rgba.push_back(static_cast<uint8_t>(v));
  return rgba;
}

Bytes png() {
  Bytes out;
  stbi_write_png_to_func(append, &out, 16, 16, 4, pixels().data(), 64);
  return out;
}

Bytes jpeg(const Bytes& rgba, int width, int height) {
  const tjhandle handle = tjInitCompress();
  unsigned char* data = nullptr;
  unsigned long size = 0;
  EXPECT_EQ(tjCompress2(handle, rgba.data(), width, 0, height, TJPF_RGBA, &data, &size, TJSAMP_444, 100, 0), 0);
  const Bytes out(data, data + size);
  tjFree(data);
  tjDestroy(handle);
  return out;
}

Bytes webp(bool lossless) {
  uint8_t* data = nullptr;
  const size_t size = lossless ? WebPEncodeLosslessRGBA(pixels().data(), 16, 16, 64, &data)
                               : WebPEncodeRGBA(pixels().data(), 16, 16, 64, 95, &data);
  const Bytes out(data, data + size);
  WebPFree(data);
  return out;
}

const Bytes kKtx2 = [] {
  Bytes b = {0xab, 'K', 'T', 'X', ' ', '2', '0', 0xbb, '\r', '\n', 0x1a, '\n'};
  b.resize(80);
  return b;
}();

void expectStandIn(const Scene& scene, const std::string& reason) {
  EXPECT_TRUE(scene.images.empty());
  EXPECT_EQ(scene.materials[0].base_image, kNone);
  EXPECT_EQ(scene.materials[0].base_color, (Vec3{0.5f, 0.5f, 0.5f}));
  EXPECT_TRUE(warns(scene, reason)) << reason;
  ASSERT_EQ(scene.materials[0].left_alone.size(), 1u);
  EXPECT_NE(scene.materials[0].left_alone[0].find("middle grey"), std::string::npos);
}

TEST(ImportPicture, ReadsPngJpegAndWebpByTheirFirstBytes) {
  const TempFolder folder;
  for (const auto& [bytes, loss] : {std::pair(png(), 0), std::pair(jpeg(pixels(), 16, 16), 12), std::pair(webp(true), 0), std::pair(webp(false), 60)})
    for (const char* mime : {"", "image/png", "image/unheard-of"}) {
      GltfFile file = fileWith({{"source", 0}});
      addImage(file, bytes, mime);
      const Scene scene = importGood(file.save(folder, "t.glb"));
      ASSERT_EQ(scene.images.size(), 1u) << mime;
      EXPECT_TRUE(scene.warnings.empty()) << scene.warnings[0];
      EXPECT_TRUE(scene.materials[0].left_alone.empty());
      const auto at = [&](size_t x, size_t c) { return int{scene.images[0].rgba[4 * (16 * 4 + x) + c]}; };
      // Lossy pictures are off by a few steps far from the edge; lossy WebP halves the colour's resolution.
      EXPECT_NEAR(at(2, 0), 255, loss);
      EXPECT_NEAR(at(2, 2), 0, loss);
      EXPECT_NEAR(at(13, 0), 0, loss);
      EXPECT_NEAR(at(13, 2), 255, loss);
      EXPECT_EQ(at(13, 3), bytes == jpeg(pixels(), 16, 16) ? 255 : 128);
    }
}

TEST(ImportPicture, SixteenBitChannelsAreHalved) {
  // 1 x 1, RGB of 16 bits (0xff12, 0x8034, 0x0056), made by hand: header, one stored DEFLATE block, CRCs left as zlib has them.
  const Bytes raw = {0, 0xff, 0x12, 0x80, 0x34, 0x00, 0x56};
  const auto chunk = [](const char* type, Bytes data) {
    Bytes body;
    for (int k = 0; k < 4; ++k) body.push_back(static_cast<uint8_t>(type[k]));
    for (const uint8_t byte : data) body.push_back(byte);
    uint32_t crc = ~0u;
    for (const uint8_t b : body) {
      crc ^= b;
      for (int k = 0; k < 8; ++k) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
    }
    const auto put = [](Bytes& out, uint32_t n) { for (int s = 24; s >= 0; s -= 8) out.push_back(static_cast<uint8_t>(n >> s)); };
    Bytes out;
    put(out, static_cast<uint32_t>(data.size()));
    for (const uint8_t byte : body) out.push_back(byte);
    put(out, ~crc);
    return out;
  };
  uint32_t a = 1, b = 0;
  for (const uint8_t v : raw) a = (a + v) % 65521, b = (b + a) % 65521;
  Bytes stream = {0x78, 0x01, 1, 7, 0, 0xf8, 0xff};
  for (const uint8_t byte : raw) stream.push_back(byte);
  for (const uint32_t v : {b >> 8, b, a >> 8, a}) stream.push_back(static_cast<uint8_t>(v));
  Bytes file_bytes = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
  for (const Bytes& part : {chunk("IHDR", {0, 0, 0, 1, 0, 0, 0, 1, 16, 2, 0, 0, 0}), chunk("IDAT", stream), chunk("IEND", {})})
    for (const uint8_t byte : part) file_bytes.push_back(byte);
  GltfFile file = fileWith({{"source", 0}});
  addImage(file, file_bytes);
  const TempFolder folder;
  const Scene scene = importGood(file.save(folder, "t.glb"));
  ASSERT_EQ(scene.images.size(), 1u);
  EXPECT_EQ(scene.images[0].rgba, (Bytes{0xff, 0x80, 0x00, 0xff}));
}

TEST(ImportPicture, WebpComesFirstAndWhatCanBeReadStandsInForWhatCannot) {
  const TempFolder folder;
  const Json both = Json::parse(R"({"source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}})");
  const Json basis = Json::parse(R"({"source": 0, "extensions": {"KHR_texture_basisu": {"source": 1}}})");
  const Json alone = Json::parse(R"({"extensions": {"KHR_texture_basisu": {"source": 1}}})");
  const Bytes broken = {'R', 'I', 'F', 'F', 9, 0, 0, 0, 'W', 'E', 'B', 'P', 'V', 'P', '8', ' ', 1};
  struct Case {
    Json texture;
    Bytes second;
    bool read;
  };
  for (const Case& c : {Case{both, webp(true), true}, Case{both, broken, true}, Case{both, kKtx2, true}, Case{basis, kKtx2, true},
                        Case{alone, kKtx2, false}, Case{alone, png(), true}}) {
    GltfFile file = fileWith(c.texture);
    addImage(file, png());
    addImage(file, c.second);
    const Scene scene = importGood(file.save(folder, "t.glb"));
    if (c.read) {
      ASSERT_EQ(scene.images.size(), 1u) << c.texture;
      EXPECT_EQ(scene.images[0].rgba[0], 255);
      EXPECT_TRUE(scene.materials[0].left_alone.empty());
    } else {
      expectStandIn(scene, "KTX2");
    }
  }
}

TEST(ImportPicture, FormatsThatCannotBeReadAreRefusedWhereTheyAreRequired) {
  const TempFolder folder;
  for (const char* extension : {"KHR_texture_basisu", "EXT_texture_avif", "MSFT_texture_dds", "EXT_texture_webp"}) {
    GltfFile file = fileWith({{"extensions", {{extension, {{"source", 0}}}}}});
    addImage(file, webp(true));
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = {extension};
    const std::string path = file.save(folder, "t.glb");
    if (std::string(extension) == "EXT_texture_webp")
      EXPECT_EQ(importGood(path).images.size(), 1u);
    else
      EXPECT_NE(importBad(path).find("PNG, JPEG or WebP"), std::string::npos);
  }
}

TEST(ImportPicture, OneThatIsMissingOrBrokenIsAWarningAndMiddleGreyStandsIn) {
  const TempFolder folder;
  folder.write("broken.png", std::string("\x89PNG\r\n\x1a\n", 8) + "no more");
  Bytes cut = jpeg(pixels(), 16, 16);
  cut.resize(100);
  folder.write("cut.jpg", std::string(cut.begin(), cut.end()));
  folder.write("anim.gif", "GIF89a...");
  for (const char* uri : {"nowhere.png", "broken.png", "cut.jpg", "anim.gif", "http://127.0.0.1:9/x.png", "../../etc/passwd",
                          "data:image/png;base64,////"}) {
    SCOPED_TRACE(uri);
    GltfFile file = fileWith({{"source", 0}});
    file.json["images"] = {{{"uri", uri}}};
    expectStandIn(importGood(file.save(folder, "t.gltf")), "image 0");
  }
  expectStandIn(importGood(fileWith(Json::object()).save(folder, "t.gltf")), "texture 0");
}

TEST(ImportPicture, WithoutItsPictureNothingIsEmitted) {
  const TempFolder folder;
  GltfFile file = fileWith({{"source", 0}});
  file.json["images"] = {{{"uri", "nowhere.png"}}};
  file.json["materials"][0] = Json::parse(R"({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}})");
  const Scene scene = importGood(file.save(folder, "t.gltf"));
  EXPECT_EQ(scene.materials[0].emission, Vec3{});
  EXPECT_EQ(scene.materials[0].left_alone.size(), 1u);
}

TEST(ImportPicture, OneLargerThanTheMemoryLimitIsAWarning) {
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

TEST(ImportPicture, OnePictureUnderManyNamesIsReadOnce) {
  const TempFolder folder;
  GltfFile file = fileWith({{"source", 0}});
  addImage(file, png());
  for (int i = 1; i < 40; ++i) {
    addImage(file, i % 2 ? png() : kKtx2);
    file.json["textures"].push_back({{"source", i}});
    file.json["materials"].push_back(file.json["materials"][0]);
    file.json["materials"][static_cast<size_t>(i)]["pbrMetallicRoughness"]["baseColorTexture"]["index"] = i;
    Json primitive = file.primitive();
    primitive["material"] = i;
    file.json["meshes"][0]["primitives"].push_back(primitive);
  }
  const Scene scene = importGood(file.save(folder, "t.glb"));
  EXPECT_EQ(scene.triangles.size(), 40u);
  EXPECT_EQ(scene.images.size(), 1u);
  EXPECT_EQ(scene.warnings.size(), 1u) << "one line for a picture that cannot be read";
}

// A picture's header may promise any size: what the bytes cannot hold is not decoded.
TEST(ImportPicture, WorkIsBoundedByTheFileAndNotByWhatItPromises) {
  const TempFolder folder;
  Bytes large_png = png(), large_jpeg = jpeg(pixels(), 16, 16);
  for (size_t i = 16; i < 24; i += 4) large_png[i + 2] = 0x40;  // 16400 x 16400
  for (size_t i = 2; i + 9 < large_jpeg.size(); ++i)
    if (large_jpeg[i] == 0xff && large_jpeg[i + 1] == 0xc0) large_jpeg[i + 5] = large_jpeg[i + 7] = 0x60;  // 24592 x 24592
  for (const Bytes& bytes : {large_png, large_jpeg}) {
    GltfFile file = fileWith({{"source", 0}});
    addImage(file, bytes);
    const std::clock_t began = std::clock();
    expectStandIn(importGood(file.save(folder, "t.glb")), "cut short");
    EXPECT_LT(static_cast<double>(std::clock() - began) / CLOCKS_PER_SEC, 1.0);
  }
}

TEST(ImportPicture, HostilePicturesOfTheSharedFolder) {
  if (!std::filesystem::exists(kHostile)) GTEST_SKIP() << "NOT TESTED: " << kHostile << " is absent";
  const TempFolder folder;
  std::filesystem::copy(kHostile / "stb_jpeg_huffman_overflow.jpg", folder.file("h.jpg"));
  GltfFile file = fileWith({{"source", 0}});
  file.json["images"] = {{{"uri", "h.jpg"}}};
  expectStandIn(importGood(file.save(folder, "t.gltf")), "image 0");
  const std::clock_t began = std::clock();  // the process's own time, whatever else is under way
  const Scene many = importGood((kHostile / "png_11000_short_x300.glb").string());
  EXPECT_EQ(many.triangles.size(), 300u);
  EXPECT_EQ(many.warnings.size(), 1u);
  EXPECT_LT(static_cast<double>(std::clock() - began) / CLOCKS_PER_SEC, 5.0);  // 27 s when each was decoded
}

}  // namespace
}  // namespace ff::bake
