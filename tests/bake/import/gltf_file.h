// Small glTF files made in a temporary folder for the importer's tests.
#pragma once
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bake/import/gltf_import.h"

namespace ff::bake {

// A folder that goes with the test.
class TempFolder {
 public:
  TempFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "ff_import_XXXXXX").string();
    if (!mkdtemp(name.data())) throw std::runtime_error("mkdtemp");
    path_ = name;
  }
  ~TempFolder() { std::filesystem::remove_all(path_); }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;
  std::string file(const std::string& name) const { return (path_ / name).string(); }
  std::string write(const std::string& name, const std::string& bytes) const {
    std::ofstream(file(name), std::ios::binary) << bytes;
    return file(name);
  }

 private:
  std::filesystem::path path_;
};

// JSON with one buffer that grows as accessors are added; every member may be edited before saving.
class GltfFile {
 public:
  using Json = nlohmann::json;
  Json json =
      Json::parse(R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
                              "meshes": [{"primitives": [{"attributes": {}}]}], "accessors": [], "bufferViews": []})");
  std::string bytes;

  // Of a .glb.
  static GltfFile load(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    const std::string all((std::istreambuf_iterator<char>(in)), {});
    uint32_t json_bytes = 0;
    std::memcpy(&json_bytes, all.data() + 12, 4);
    GltfFile file;
    file.json = Json::parse(all.substr(20, json_bytes));
    file.json.erase("buffers");
    file.bytes = all.substr(std::min<size_t>(all.size(), 28 + json_bytes));
    return file;
  }

  template <class T>
  int view(const std::vector<T>& values) {
    while (bytes.size() % 4) bytes += '\0';
    json["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", bytes.size()}, {"byteLength", values.size() * sizeof(T)}});
    bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
    return static_cast<int>(json["bufferViews"].size()) - 1;
  }
  // Returns the accessor's number.
  template <class T>
  int accessor(const std::vector<T>& values, int component_type, const std::string& type, bool normalized = false) {
    const size_t components = type == "SCALAR" ? 1 : static_cast<size_t>(type[3] - '0');
    json["accessors"].push_back({{"bufferView", view(values)},
                                 {"componentType", component_type},
                                 {"type", type},
                                 {"count", values.size() / components}});
    if (normalized) json["accessors"].back()["normalized"] = true;
    return static_cast<int>(json["accessors"].size()) - 1;
  }
  int floats(const std::vector<float>& values, const std::string& type) { return accessor(values, 5126, type); }
  Json& primitive() { return json["meshes"][0]["primitives"][0]; }
  // A right triangle with legs of 1 m in the z = 0 plane, facing +z.
  GltfFile& withTriangle() {
    primitive()["attributes"]["POSITION"] = floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3");
    return *this;
  }

  // name.gltf with name.bin, or name.glb.
  std::string save(const TempFolder& folder, const std::string& name) {
    const bool glb = name.size() > 4 && name.substr(name.size() - 4) == ".glb";
    while (bytes.size() % 4) bytes += '\0';
    if (!bytes.empty() && !json.contains("buffers")) {
      json["buffers"] = {{{"byteLength", bytes.size()}}};
      if (!glb) {
        json["buffers"][0]["uri"] = name + ".bin";
        folder.write(name + ".bin", bytes);
      }
    }
    std::string text = json.dump();
    if (!glb) return folder.write(name, text);
    while (text.size() % 4) text += ' ';
    return folder.write(name, word(0x46546c67) + word(2) + word(28 + text.size() + bytes.size()) + word(text.size()) +
                                  word(0x4e4f534a) + text + word(bytes.size()) + word(0x004e4942) + bytes);
  }

  static std::string word(uint64_t n) {
    const auto n32 = static_cast<uint32_t>(n);
    std::string out(4, '\0');
    std::memcpy(out.data(), &n32, 4);
    return out;
  }
};

inline Scene importGood(const std::string& path) {
  auto scene = importGltf(path);
  EXPECT_TRUE(scene) << scene.error().line();
  return scene ? std::move(*scene) : Scene{};
}

// The error's line; the test fails if the file loads.
inline std::string importBad(const std::string& path) {
  const auto scene = importGltf(path);
  EXPECT_FALSE(scene) << path << " loads";
  if (scene) return {};
  const std::string line = scene.error().line();
  EXPECT_EQ(line.find('\n'), std::string::npos);
  EXPECT_EQ(line.compare(0, path.size(), path), 0) << "names the file: " << line;
  return line;
}

inline Vec3 corner(const Scene& scene, size_t triangle, size_t k) {
  return scene.positions[scene.triangles[triangle].v[k]];
}

// Twice the vector area: along the front's normal.
inline Vec3 areaVector(const Scene& scene, size_t triangle) {
  const Vec3 a = corner(scene, triangle, 0);
  return cross(corner(scene, triangle, 1) - a, corner(scene, triangle, 2) - a);
}

inline void expectNear(Vec3 a, Vec3 b, float tolerance = 1e-6f) {
  EXPECT_NEAR(a.x, b.x, tolerance);
  EXPECT_NEAR(a.y, b.y, tolerance);
  EXPECT_NEAR(a.z, b.z, tolerance);
}

inline bool warns(const Scene& scene, const std::string& text) {
  for (const std::string& w : scene.warnings)
    if (w.find(text) != std::string::npos) return true;
  return false;
}

}  // namespace ff::bake
