#include <set>

#include "bake/import/validate.h"

namespace ff::bake::gltf {
namespace {

constexpr int kByte = 5120, kUnsignedByte = 5121, kShort = 5122, kUnsignedShort = 5123, kUnsignedInt = 5125,
              kFloat = 5126;

// What may be read as an attribute of this name; quantized: KHR_mesh_quantization is in use.
void checkFormat(const Item& item, const std::string& name, uint32_t accessor, const AccessorFacts& f, bool quantized) {
  const bool small = f.component_type == kByte || f.component_type == kUnsignedByte || f.component_type == kShort ||
                     f.component_type == kUnsignedShort;
  const bool core_small = (f.component_type == kUnsignedByte || f.component_type == kUnsignedShort) && f.normalized;
  bool fits = false;
  if (name == "POSITION")
    fits = f.type == "VEC3" && (f.component_type == kFloat || (small && quantized));
  else if (name == "COLOR_0")
    fits = (f.type == "VEC3" || f.type == "VEC4") && (f.component_type == kFloat || core_small);
  else
    fits = f.type == "VEC2" && (f.component_type == kFloat || core_small || (small && quantized));
  if (!fits)
    refuse(item.place(), name + ": accessor " + std::to_string(accessor) + " has type " + f.type +
                             " of component type " + std::to_string(f.component_type) +
                             (f.normalized ? " (normalized)" : ""));
}

// TEXCOORD_<n> without leading zeros, n below 64.
bool isTexCoord(const std::string& name) {
  if (name.compare(0, 9, "TEXCOORD_") != 0 || name.size() < 10 || name.size() > 11) return false;
  for (size_t i = 9; i < name.size(); ++i)
    if (name[i] < '0' || name[i] > '9') return false;
  return name.size() == 10 || (name[9] != '0' && name.substr(9) < "64");
}

Json validateDraco(const Item& item, const Item& draco, const Json& kept, const std::vector<AccessorFacts>& accessors,
                   size_t view_count, uint64_t vertex_count, uint64_t index_count) {
  const auto view = draco.reference("bufferView", view_count, "bufferView");
  if (!view) refuse(draco.place(), "bufferView is missing");
  const auto ids = draco.object("attributes");
  if (!ids || !ids->has("POSITION")) refuse(draco.place(), "attributes has no POSITION");
  Json out = {{"bufferView", *view},
              {"vertexCount", vertex_count},
              {"indexCount", index_count},
              {"attributes", Json::object()}};
  for (const auto& [name, accessor] : kept.items()) {
    if (!ids->has(name.c_str())) refuse(item.place(), name + " is not among the Draco attributes");
    const uint64_t id = *ids->integer(name.c_str());
    if (id > 0x7fffffff) refuse(draco.place(), name + " has the attribute id " + std::to_string(id));
    out["attributes"][name] = id;
    if (accessors[accessor.get<size_t>()].normalized) out["normalized"][name] = true;
  }
  return out;
}

}  // namespace

Json validateMeshes(const Item& file, const std::vector<AccessorFacts>& accessors, size_t material_count,
                    size_t view_count, std::vector<std::string>& warnings) {
  bool quantized = false;
  for (const char* list : {"extensionsUsed", "extensionsRequired"})
    if (file.has(list))
      for (const Json& name : file.json()[list]) quantized = quantized || name == "KHR_mesh_quantization";
  Json out = Json::array();
  for (const Item& mesh : file.items("meshes", "mesh")) {
    Json primitives = Json::array();
    const auto list = mesh.items("primitives", "primitive");
    if (list.empty()) refuse(mesh.place(), "has no primitives");
    for (const Item& item : list) {
      const uint64_t mode = item.integer("mode").value_or(4);
      if (mode > 6) refuse(item.place(), "mode " + std::to_string(mode) + " is unknown");
      const auto material = item.reference("material", material_count, "material");
      const auto attributes = item.object("attributes");
      if (!attributes) refuse(item.place(), "attributes is missing");
      const auto indices = item.reference("indices", accessors.size(), "accessor");
      Json kept = Json::object();
      uint64_t vertex_count = 0;
      for (const auto& [name, unused] : attributes->json().items()) {
        if (name != "POSITION" && name != "COLOR_0" && !isTexCoord(name)) continue;
        const uint32_t accessor = *attributes->reference(name.c_str(), accessors.size(), "accessor");
        const AccessorFacts& f = accessors[accessor];
        checkFormat(item, name, accessor, f, quantized);
        if (vertex_count && f.count != vertex_count)
          refuse(item.place(), name + ": accessor " + std::to_string(accessor) + " has " + std::to_string(f.count) +
                                   " elements, another attribute " + std::to_string(vertex_count));
        vertex_count = f.count;
        kept[name] = accessor;
      }
      uint64_t index_count = 0;
      if (indices) {
        const AccessorFacts& f = accessors[*indices];
        index_count = f.count;
        if (f.strided)
          refuse(item.place(), "indices: the bufferView of accessor " + std::to_string(*indices) + " has a byteStride");
        if (f.type != "SCALAR" || f.normalized ||
            (f.component_type != kUnsignedByte && f.component_type != kUnsignedShort &&
             f.component_type != kUnsignedInt))
          refuse(item.place(), "indices: accessor " + std::to_string(*indices) + " has type " + f.type +
                                   " of component type " + std::to_string(f.component_type));
      }
      if (mode < 4) {
        warnings.push_back(item.place() + ": points or lines are left out");
        continue;
      }
      if (!kept.contains("POSITION")) {
        warnings.push_back(item.place() + ": has no POSITION and is left out");
        continue;
      }
      Json validated = {{"mode", mode}, {"attributes", kept}};
      if (material) validated["material"] = *material;
      if (const auto draco = item.extension("KHR_draco_mesh_compression")) {
        if (mode == 6) refuse(item.place(), "a triangle fan cannot be Draco-compressed");
        validated["extensions"]["KHR_draco_mesh_compression"] =
            validateDraco(item, *draco, kept, accessors, view_count, vertex_count, index_count);
      } else if (indices) {
        if (accessors[*indices].view < 0) {  // all zeros, as the specification has it
          warnings.push_back(item.place() + ": its indices have no bufferView: no triangle has an area");
          continue;
        }
        validated["indices"] = *indices;
      }
      primitives.push_back(std::move(validated));
    }
    out.push_back({{"primitives", std::move(primitives)}});
  }
  return out;
}

}  // namespace ff::bake::gltf
