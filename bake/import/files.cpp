#include "bake/import/files.h"

#include <xxhash.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <system_error>
#include <utility>

#include "bake/import/instances.h"
#include "bake/import/json.h"
#include "bake/import/validate.h"
#include "formats/storage/storage.h"

namespace ff::bake {
namespace {

bool isScene(const std::string& name) {
  std::string lower = name;
  for (char& c : lower) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return lower.ends_with(".glb") || lower.ends_with(".gltf");
}

using ImageKey = std::pair<uint64_t, uint64_t>;
ImageKey keyOf(const Image& image) {
  const XXH128_hash_t h = XXH3_128bits_withSeed(image.rgba.data(), image.rgba.size(), uint64_t{image.width} << 32 | image.height);
  return {h.high64, h.low64};
}

template <class Array>
void append(Array& to, Array& from) {
  to.insert(to.end(), std::make_move_iterator(from.begin()), std::make_move_iterator(from.end()));
}

// Attributes that a scene has for all positions or for none: where some of all have them, the others get the default.
template <class Array>
void appendAttribute(Array& to, size_t positions_before, Array& from, size_t positions) {
  if (to.empty() && from.empty()) return;
  to.resize(positions_before);
  from.resize(positions);
  append(to, from);
}

class Joiner {
 public:
  explicit Joiner(Scene first) : all_(std::move(first)) {
    for (uint32_t i = 0; i < all_.images.size(); ++i) images_.emplace(keyOf(all_.images[i]), i);
    hashes_.push_back(all_.content_hash);
  }

  // Errors (kUsage): too much for one scene.
  Result<void> add(Scene scene) {
    if (all_.positions.size() + scene.positions.size() >= kNone || all_.triangles.size() + scene.triangles.size() >= kNone)
      return Error{ErrorCode::kUsage, scene.name, "", "with the files before it it has more corners than one scene may", "bake fewer files at a time"};
    hashes_.push_back(scene.content_hash);
    std::array<float, 3> shift;  // scenes far from zero have origins of their own
    for (size_t a = 0; a < 3; ++a) shift[a] = static_cast<float>(scene.origin[a] - all_.origin[a]);
    const Vec3 moved{shift[0], shift[1], shift[2]};
    for (Vec3& p : scene.positions) p += moved;
    for (formats::Light& light : scene.lights) light.position += moved;

    const auto positions = static_cast<uint32_t>(all_.positions.size()), triangles = static_cast<uint32_t>(all_.triangles.size());
    const auto materials = static_cast<uint32_t>(all_.materials.size());
    const auto nodes = static_cast<uint32_t>(all_.node_names.size()), meshes = static_cast<uint32_t>(all_.mesh_names.size());
    std::vector<uint32_t> image(scene.images.size());
    for (size_t i = 0; i < image.size(); ++i) {
      const auto [known, is_new] = images_.emplace(keyOf(scene.images[i]), static_cast<uint32_t>(all_.images.size()));
      if (is_new) all_.images.push_back(std::move(scene.images[i]));
      image[i] = known->second;
    }
    for (Material& m : scene.materials)
      for (uint32_t* used : {&m.base_image, &m.emission_image})
        if (*used != kNone) *used = image[*used];
    for (Triangle& t : scene.triangles) {
      for (uint32_t& v : t.v) v += positions;
      t.material += materials;
    }
    for (Object& o : scene.objects) {
      o.first_triangle += triangles;
      if (o.node != kNone) o.node += nodes;
      if (o.mesh != kNone) o.mesh += meshes;
    }
    appendAttribute(all_.uv0, positions, scene.uv0, scene.positions.size());
    appendAttribute(all_.uv1, positions, scene.uv1, scene.positions.size());
    appendAttribute(all_.colors, positions, scene.colors, scene.positions.size());
    append(all_.positions, scene.positions);
    append(all_.triangles, scene.triangles);
    append(all_.materials, scene.materials);
    append(all_.objects, scene.objects);
    append(all_.node_names, scene.node_names);
    append(all_.mesh_names, scene.mesh_names);
    append(all_.lights, scene.lights);
    for (std::string& line : scene.left_alone)
      if (std::find(all_.left_alone.begin(), all_.left_alone.end(), line) == all_.left_alone.end()) all_.left_alone.push_back(std::move(line));
    for (std::string& line : scene.warnings) all_.warnings.push_back(scene.name + ": " + line);
    all_.without_area += scene.without_area;
    for (FoundPlace& place : scene.without_area_at)
      if (all_.without_area_at.size() < kMaxPlaces) all_.without_area_at.push_back(std::move(place));
    return {};
  }

  Scene joined() {
    if (hashes_.size() > 1) {
      all_.name += " and " + std::to_string(hashes_.size() - 1) + " more";
      XXH128_canonical_t digest;
      XXH128_canonicalFromHash(&digest, XXH3_128bits(hashes_.data(), hashes_.size() * sizeof hashes_[0]));
      std::memcpy(all_.content_hash.data(), digest.digest, all_.content_hash.size());
    }
    return std::move(all_);
  }

 private:
  Scene all_;
  std::map<ImageKey, uint32_t> images_;
  std::vector<std::array<uint8_t, 16>> hashes_;
};

Result<void> addFolder(const std::string& folder, const gltf::Matrix& placed, std::vector<SceneFile>& files) {
  const auto names = formats::posixStorage()->list(folder);
  if (!names) return names.error();
  const size_t before = files.size();
  for (const std::string& name : *names)
    if (isScene(name)) files.push_back({folder + (folder.ends_with('/') ? "" : "/") + name, placed});
  if (files.size() == before) return Error{ErrorCode::kIo, folder, "", "the folder holds no .glb or .gltf file", "name the scene's files"};
  return {};
}

Result<void> addFiles(const std::string& path, const gltf::Matrix& placed, std::vector<SceneFile>& files) {
  std::error_code unknown;
  if (std::filesystem::is_directory(path, unknown)) return addFolder(path, placed, files);
  files.push_back({path, placed});
  return {};
}

// Throws gltf::ImportError where the list is wrong.
Result<void> addList(const std::string& list, std::vector<SceneFile>& files) {
  const auto bytes = formats::readWholeFile(*formats::posixStorage(), list);
  if (!bytes) return bytes.error();
  const auto* text = reinterpret_cast<const char*>(bytes->data());
  const gltf::Json parsed = gltf::Json::parse(text, text + bytes->size(), nullptr, false);
  if (!parsed.is_object() || !parsed.contains("files") || !parsed["files"].is_array() || parsed["files"].empty())
    gltf::refuse("", "is not a list of scene files", "{\"files\": [\"a.glb\", {\"path\": \"b.glb\", \"translation\": [100, 0, 0]}]}, for one");
  size_t number = 0;
  for (const gltf::Json& entry : parsed["files"]) {
    const std::string place = "file " + std::to_string(number++);
    gltf::Json named{{"path", entry}};
    const gltf::Item item(entry.is_string() ? named : entry, place);
    for (const auto& [key, value] : item.json().items())
      if (key != "path" && key != "matrix" && key != "translation" && key != "rotation" && key != "scale")
        gltf::refuse(place, "\"" + gltf::printable(key) + "\" is not known", "path, matrix, translation, rotation and scale are");
    const std::string path = item.text("path");
    if (path.empty() || path.ends_with(".json")) gltf::refuse(place, "path must name a .glb or .gltf file, or a folder", "name one");
    const gltf::Matrix placed = gltf::validateTransform(item);
    if (!(std::abs(gltf::determinant(placed)) > 0)) gltf::refuse(place, "its scale is zero", "give another");
    if (auto ok = addFiles(path.starts_with('/') ? path : formats::folderOf(list) + path, placed, files); !ok) return ok;
  }
  return {};
}

}  // namespace

Result<std::vector<SceneFile>> sceneFiles(std::span<const std::string> paths) {
  std::vector<SceneFile> files;
  for (const std::string& path : paths) {
    try {
      const auto ok = path.ends_with(".json") ? addList(path, files) : addFiles(path, SceneFile{}.placed, files);
      if (!ok) return ok.error();
    } catch (gltf::ImportError& fault) {
      fault.error.file = path;
      return fault.error;
    }
  }
  return files;
}

Result<Scene> importFiles(std::span<const SceneFile> files, const ImportLimits& limits) {
  if (files.empty()) return Error{ErrorCode::kUsage, "", "", "no scene is given", "name a .glb or .gltf file"};
  ImportLimits of_each = limits;
  if (files.size() > 1) of_each.progress = {};
  std::optional<Joiner> all;
  for (size_t f = 0; f < files.size(); ++f) {
    if (limits.progress && files.size() > 1) limits.progress(f, files.size());
    of_each.placed = files[f].placed;
    auto scene = importGltf(files[f].path, of_each);
    if (!scene || files.size() == 1) return scene;
    if (!all) all.emplace(std::move(*scene));
    else if (auto ok = all->add(std::move(*scene)); !ok) return ok.error();
  }
  if (limits.progress) limits.progress(files.size(), files.size());
  return all->joined();
}

}  // namespace ff::bake
