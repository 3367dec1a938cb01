#include "bake/import/document.h"

#include <algorithm>
#include <array>

#include "bake/import/meshopt.h"

namespace ff::bake::gltf {
namespace {

// Extensions that a file may require. Those that change geometry or diffuse light are read; the others cannot change
// what a radiosity baker sees.
constexpr std::array kSupported = {"KHR_draco_mesh_compression",
                                   "KHR_mesh_quantization",
                                   "KHR_texture_transform",
                                   "EXT_mesh_gpu_instancing",
                                   "EXT_meshopt_compression",
                                   "KHR_meshopt_compression",
                                   "KHR_node_visibility",
                                   "KHR_lights_punctual",
                                   "EXT_lights_ies",
                                   "EXT_lights_image_based",
                                   "KHR_animation_pointer",
                                   "KHR_node_hoverability",
                                   "KHR_node_selectability",
                                   "EXT_texture_webp",
                                   "KHR_xmp_json_ld",
                                   "EXT_mesh_features",
                                   "EXT_instance_features",
                                   "EXT_structural_metadata",
                                   "MSFT_lod"};

void checkAsset(const Item& file) {
  const auto asset = file.object("asset");
  if (!asset) refuse("asset", "is missing", "export as glTF 2.0");
  const std::string version = asset->text("version");
  if (version.size() < 3 || version.compare(0, 2, "2.") != 0 ||
      version.find_first_not_of("0123456789", 2) != std::string::npos)
    refuse("asset", "version \"" + printable(version) + "\", only 2.x can be read", "export as glTF 2.0");
  const std::string least = asset->text("minVersion");
  if (!least.empty() && least != "2.0" && (least != "2.1" || version == "2.0"))
    refuse("asset",
           "minVersion \"" + printable(least) + "\" with version \"" + version + "\", only 2.0 and 2.1 can be read",
           "export as glTF 2.0");
}

void checkExtensions(const Item& file) {
  for (const char* list : {"extensionsUsed", "extensionsRequired"}) {
    if (!file.has(list)) continue;
    const Json& names = file.json()[list];
    if (!names.is_array()) refuse(list, "must be an array");
    for (const Json& name : names) {
      if (!name.is_string()) refuse(list, "must hold strings");
      if (list[10] != 'R') continue;
      const auto text = name.get<std::string>();
      if (text.compare(0, 14, "KHR_materials_") == 0) continue;
      if (std::find(kSupported.begin(), kSupported.end(), text) == kSupported.end())
        refuse(list, "\"" + printable(text) + "\" is not supported",
               text.find("_texture_") == std::string::npos ? "export without it" : "export its pictures as PNG, JPEG or WebP");
    }
  }
}

void loadBuffers(const Item& file, Container& container, Storage& storage, Budget& budget) {
  const auto items = file.items("buffers", "buffer");
  for (size_t i = 0; i < items.size(); ++i) {
    const Item& item = items[i];
    const uint64_t bytes = item.requiredInteger("byteLength");
    if (bytes < 1) refuse(item.place(), "byteLength 0");
    std::vector<uint8_t> data;
    bool present = true;
    if (item.has("uri")) {
      const std::string uri = item.text("uri");
      data = isDataUri(uri) ? decodeDataUri(uri, item.place(), budget)
                            : readFile(resolveUri(uri, container.folder, item.place()), bytes, item.place(), budget);
    } else if (i == 0 && container.has_bin) {
      data = std::move(container.bin);
    } else if (i == 0 && container.is_glb && !item.has("extensions")) {
      refuse(item.place(), "has no uri, and the file has no BIN chunk");
    } else {
      present = false;  // of use to an application that knows better, or the fallback of a compressed bufferView
    }
    if (present && data.size() < bytes)
      refuse(item.place(),
             "byteLength " + std::to_string(bytes) + ", only " + std::to_string(data.size()) + " bytes are there",
             "fetch or export the file again");
    if (present) data.resize(bytes);
    storage.buffers.push_back(std::move(data));
    storage.present.push_back(present);
  }
  // What accessors and views are checked against; buffers that are absent have only their promise.
  for (const Item& item : file.items("bufferViews", "bufferView")) {
    const auto buffer = item.reference("buffer", items.size(), "buffer");
    if (!buffer) refuse(item.place(), "buffer is missing");
    Extents e;
    e.buffer = *buffer;
    e.offset = item.integer("byteOffset").value_or(0);
    e.length = item.requiredInteger("byteLength");
    const uint64_t bytes = items[*buffer].requiredInteger("byteLength");
    if (e.offset > bytes || e.length > bytes - e.offset)
      refuse(item.place(), "offset " + std::to_string(e.offset) + " and length " + std::to_string(e.length) +
                               " end past buffer " + std::to_string(*buffer) + " of " + std::to_string(bytes) +
                               " bytes");
    if (const auto stride = item.integer("byteStride")) {
      if (*stride < 4 || *stride > 252 || *stride % 4)
        refuse(item.place(), "byteStride " + std::to_string(*stride) + " must be a multiple of 4 from 4 to 252");
      if (*stride > e.length) refuse(item.place(), "byteStride " + std::to_string(*stride) + " exceeds its byteLength");
      e.stride = *stride;
    }
    storage.views.push_back(e);
  }
  decodeMeshoptViews(file, storage, budget);
}

// Images are read later and only where a surface shows them; here they become sources, textures and samplers.
Json validateTextures(const Item& file, size_t view_count, std::vector<ImageSource>& images,
                      std::vector<std::vector<uint32_t>>& texture_images, Json& samplers) {
  for (const Item& item : file.items("images", "image")) {
    ImageSource source;
    if (const auto view = item.reference("bufferView", view_count, "bufferView")) source.view = static_cast<int>(*view);
    source.uri = item.text("uri");
    if (source.view >= 0 && !source.uri.empty()) refuse(item.place(), "has both uri and bufferView");
    images.push_back(std::move(source));
  }
  samplers = Json::array();
  for (const Item& item : file.items("samplers", "sampler")) {
    Json validated = Json::object();
    for (const char* key : {"wrapS", "wrapT"})
      if (const auto wrap = item.integer(key)) {
        if (*wrap != 10497 && *wrap != 33071 && *wrap != 33648)
          refuse(item.place(), std::string(key) + " " + std::to_string(*wrap) + " is unknown");
        validated[key] = *wrap;
      }
    samplers.push_back(std::move(validated));
  }
  Json out = Json::array();
  for (const Item& item : file.items("textures", "texture")) {
    Json validated = Json::object();
    // What an extension names comes first where it can be read; else it is what the texture has besides a fallback.
    std::vector<uint32_t> sources;
    const auto add = [&](const Item& holder) {
      if (const auto source = holder.reference("source", images.size(), "image")) sources.push_back(*source);
    };
    if (const auto webp = item.extension("EXT_texture_webp")) add(*webp);
    add(item);
    for (const char* other : {"KHR_texture_basisu", "EXT_texture_avif", "MSFT_texture_dds"})
      if (const auto extension = item.extension(other)) add(*extension);
    texture_images.push_back(std::move(sources));
    if (const auto sampler = item.reference("sampler", samplers.size(), "sampler")) validated["sampler"] = *sampler;
    out.push_back(std::move(validated));
  }
  return out;
}

// Serves the loaded buffers to tinygltf under the names "0", "1", ...
struct BufferServer {
  std::vector<std::vector<uint8_t>>* buffers;

  static std::vector<uint8_t>* find(const std::string& path, void* self) {
    auto& all = *static_cast<BufferServer*>(self)->buffers;
    const size_t slash = path.rfind('/');
    const std::string name = slash == std::string::npos ? path : path.substr(slash + 1);
    if (name.empty() || name.size() > 10 || name.find_first_not_of("0123456789") != std::string::npos) return nullptr;
    const uint64_t n = std::stoull(name);
    return n < all.size() ? &all[n] : nullptr;
  }
  static bool exists(const std::string& path, void* self) { return find(path, self) != nullptr; }
  static std::string expand(const std::string& path, void*) { return path; }
  static bool readAll(std::vector<unsigned char>* out, std::string*, const std::string& path, void* self) {
    std::vector<uint8_t>* data = find(path, self);
    if (data) *out = std::move(*data);
    return data != nullptr;
  }
  static bool writeNothing(std::string*, const std::string&, const std::vector<unsigned char>&, void*) { return false; }
};

void hand(Storage& storage, Json& json) {
  json["buffers"] = Json::array();
  for (size_t i = 0; i < storage.buffers.size(); ++i) {
    if (!storage.present[i]) storage.buffers[i].assign(1, 0);  // tinygltf knows no absent buffers; never read
    json["buffers"].push_back({{"byteLength", storage.buffers[i].size()}, {"uri", std::to_string(i)}});
  }
  json["bufferViews"] = Json::array();
  for (const Extents& e : storage.views) {
    Json view = {{"buffer", e.buffer}, {"byteOffset", e.offset}, {"byteLength", e.length}};
    if (e.stride) view["byteStride"] = e.stride;
    json["bufferViews"].push_back(std::move(view));
  }
}

}  // namespace

Document loadDocument(const std::string& path, Budget& budget, std::vector<std::string>& warnings) {
  Document out;
  Storage storage;
  std::string text;
  uint64_t json_bytes = 0;
  {
    Container container = readContainer(path, budget, warnings);
    json_bytes = container.json_bytes;
    out.folder = container.folder;
    const Item file(container.json, "file");
    checkAsset(file);
    checkExtensions(file);
    loadBuffers(file, container, storage, budget);
    Json validated = {{"asset", {{"version", "2.0"}}}};
    std::vector<AccessorFacts> accessors;
    validated["accessors"] = validateAccessors(file, storage, accessors);
    validated["textures"] = validateTextures(file, storage.views.size(), out.images, out.texture_images, validated["samplers"]);
    validated["materials"] = validateMaterials(file, validated["textures"].size(), budget, out.material_facts, warnings);
    validated["meshes"] = validateMeshes(file, accessors, validated["materials"].size(), storage.views.size(), warnings);
    out.nodes = validateNodes(file, accessors, validated["meshes"].size(), out.roots);
    out.objects = readObjects(file);
    out.lights = readLights(file, warnings);
    out.buffer_present = storage.present;
    hand(storage, validated);
    text = validated.dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  if (text.size() > 0xffffffffu) refuse("JSON", "larger than 4 GiB");
  BufferServer server{&storage.buffers};
  tinygltf::TinyGLTF loader;
  loader.SetFsCallbacks(
      {&BufferServer::exists, &BufferServer::expand, &BufferServer::readAll, &BufferServer::writeNothing, &server});
  std::string error, warning;
  if (!loader.LoadASCIIFromString(&out.model, &error, &warning, text.c_str(), static_cast<unsigned>(text.size()), "",
                                  0))
    refuse("tinygltf", printable(error));
  budget.give(json_bytes / 4 * 3);  // the parsed trees are gone, tinygltf's structures stay
  return out;
}

}  // namespace ff::bake::gltf
