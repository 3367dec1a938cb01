#include "tools/scene/glb.h"

#include <draco/compression/decode.h>
#include <draco/compression/encode.h>
#include <draco/mesh/mesh.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <tuple>

#include "formats/version.h"

static_assert(std::endian::native == std::endian::little, "glTF buffers are little-endian and written as they lie");

namespace ff::tools {
namespace {

using nlohmann::json;
constexpr int kFloat = 5126, kUint16 = 5123, kUint32 = 5125, kVertices = 34962, kIndices = 34963;

Error cannot(const std::string& what, const std::string& remedy) {
  return {ErrorCode::kUsage, "", "", what, remedy};
}

json triple(Vec3 v) { return json::array({v.x, v.y, v.z}); }

// Nine floats a triangle, starting at its smallest corner: equal for equal oriented triangles.
using FlatTriangle = std::array<float, 9>;

FlatTriangle canonical(std::array<Vec3, 3> t) {
  const auto before = [](Vec3 a, Vec3 b) { return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z); };
  std::rotate(t.begin(), std::min_element(t.begin(), t.end(), before), t.end());
  return {t[0].x, t[0].y, t[0].z, t[1].x, t[1].y, t[1].z, t[2].x, t[2].y, t[2].z};
}

struct DracoPart {
  std::vector<uint8_t> bytes;
  uint32_t vertices = 0, attribute = 0;
};

struct Bounds {
  Vec3 lo, hi;
};

// Draco permutes and may duplicate vertices, so the decoded triangles are compared as a set.
Result<DracoPart> compress(const ScenePart& part, bool integer_grid, const Bounds& world) {
  const auto faces = static_cast<uint32_t>(part.indices.size() / 3);
  draco::Mesh mesh;
  mesh.set_num_points(static_cast<uint32_t>(part.positions.size()));
  draco::GeometryAttribute attribute;
  attribute.Init(draco::GeometryAttribute::POSITION, nullptr, 3, draco::DT_FLOAT32, false, 3 * sizeof(float), 0);
  const int id = mesh.AddAttribute(attribute, true, static_cast<uint32_t>(part.positions.size()));
  for (uint32_t i = 0; i < part.positions.size(); ++i) {
    const std::array<float, 3> p{part.positions[i].x, part.positions[i].y, part.positions[i].z};
    mesh.attribute(id)->SetAttributeValue(draco::AttributeValueIndex(i), p.data());
  }
  for (uint32_t f = 0; f < faces; ++f) {
    draco::Mesh::Face face;
    for (uint32_t k = 0; k < 3; ++k) face[k] = draco::PointIndex(part.indices[3 * f + k]);
    mesh.AddFace(face);
  }
  draco::Encoder encoder;
  encoder.SetSpeedOptions(3, 3);
  if (integer_grid) {
    // Range = 2^bits - 1 makes the quantisation step exactly 1, so integers come back as they were.
    const Vec3 extent = world.hi - world.lo;
    int bits = 16;
    while (bits < 24 && std::max({extent.x, extent.y, extent.z}) > static_cast<float>((1 << bits) - 1)) ++bits;
    const std::array<float, 3> origin{world.lo.x, world.lo.y, world.lo.z};
    encoder.SetAttributeExplicitQuantization(draco::GeometryAttribute::POSITION, bits, 3, origin.data(),
                                             static_cast<float>((1 << bits) - 1));
  }
  draco::EncoderBuffer buffer;
  if (const draco::Status s = encoder.EncodeMeshToBuffer(mesh, &buffer); !s.ok())
    return cannot("Draco cannot encode a mesh: " + s.error_msg_string(), "leave --draco out");

  draco::DecoderBuffer in;
  in.Init(buffer.data(), buffer.size());
  auto decoded = draco::Decoder().DecodeMeshFromBuffer(&in);
  if (!decoded.ok()) return cannot("Draco cannot decode its own mesh: " + decoded.status().error_msg_string(), "");
  const draco::Mesh& back = *decoded.value();
  const draco::PointAttribute* position = back.GetNamedAttribute(draco::GeometryAttribute::POSITION);
  std::vector<FlatTriangle> before, after;
  for (uint32_t f = 0; f < faces; ++f)
    before.push_back(canonical({part.positions[part.indices[3 * f]], part.positions[part.indices[3 * f + 1]],
                                part.positions[part.indices[3 * f + 2]]}));
  for (uint32_t f = 0; f < back.num_faces(); ++f) {
    std::array<Vec3, 3> t;
    for (size_t k = 0; k < 3; ++k) {
      std::array<float, 3> p{};
      position->GetMappedValue(back.face(draco::FaceIndex(f))[k], p.data());
      t[k] = {p[0], p[1], p[2]};
    }
    after.push_back(canonical(t));
  }
  std::ranges::sort(before);
  std::ranges::sort(after);
  if (before != after) return cannot("Draco changes the geometry of a mesh", "leave --draco out");
  DracoPart out;
  out.bytes.assign(buffer.data(), buffer.data() + buffer.size());
  out.vertices = back.num_points();
  out.attribute = position->unique_id();
  return out;
}

class GlbBuilder {
 public:
  GlbBuilder(const SceneModel& model, const GlbOptions& options) : model_(model), options_(options) {
    bounds_ = {{1e30f, 1e30f, 1e30f}, {-1e30f, -1e30f, -1e30f}};
    for (const SceneNode& node : model.nodes)
      for (const ScenePart& part : node.parts)
        for (Vec3 p : part.positions) bounds_ = {ff::min(bounds_.lo, p), ff::max(bounds_.hi, p)};
  }

  Result<std::vector<uint8_t>> build() {
    gltf_["asset"] = {{"version", "2.0"}, {"generator", std::string("ffscene ") + FF_VERSION}};
    writeMaterials();
    json root = {{"name", model_.name}, {"children", json::array()}};
    if (model_.scale != 1) root["scale"] = triple({model_.scale, model_.scale, model_.scale});
    gltf_["nodes"] = json::array({root});
    for (const SceneNode& node : model_.nodes) {
      json primitives = json::array();
      for (const ScenePart& part : node.parts) {
        if (part.indices.empty()) continue;
        const auto written = options_.draco ? writeDraco(part) : writePlain(part);
        if (!written) return written.error();
        primitives.push_back(*written);
      }
      if (primitives.empty()) continue;
      gltf_["nodes"][0]["children"].push_back(gltf_["nodes"].size());
      gltf_["nodes"].push_back({{"name", node.name}, {"mesh", gltf_["meshes"].size()}});
      gltf_["meshes"].push_back({{"name", node.name}, {"primitives", primitives}});
    }
    if (!gltf_.contains("meshes")) return cannot("the scene is empty", "");
    gltf_["scenes"] = json::array({{{"name", model_.name}, {"nodes", {0}}}});
    gltf_["scene"] = 0;
    gltf_["buffers"] = json::array({{{"byteLength", bin_.size()}}});
    std::vector<std::string> used;
    if (emissive_) used.push_back("KHR_materials_emissive_strength");
    if (options_.draco) {
      used.push_back("KHR_draco_mesh_compression");
      gltf_["extensionsRequired"] = {"KHR_draco_mesh_compression"};
    }
    if (!used.empty()) gltf_["extensionsUsed"] = used;
    return container();
  }

 private:
  void writeMaterials() {
    for (const SceneMaterial& m : model_.materials) {
      json out = {{"name", m.name},
                  {"pbrMetallicRoughness",
                   {{"baseColorFactor", {m.base_color.x, m.base_color.y, m.base_color.z, 1.0}},
                    {"metallicFactor", 0.0},
                    {"roughnessFactor", 1.0}}}};
      // glTF allows factors up to 1: the largest channel becomes the strength.
      const float strength = std::max({m.radiance.x, m.radiance.y, m.radiance.z});
      if (strength > 0) {
        out["emissiveFactor"] = triple(m.radiance / strength);
        out["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"] = strength;
        emissive_ = true;
      }
      gltf_["materials"].push_back(out);
    }
  }

  size_t addView(const void* data, size_t bytes, int target) {
    bin_.resize((bin_.size() + 3) / 4 * 4);
    json view = {{"buffer", 0}, {"byteOffset", bin_.size()}, {"byteLength", bytes}};
    if (target != 0) view["target"] = target;
    const auto* p = static_cast<const uint8_t*>(data);
    bin_.insert(bin_.end(), p, p + bytes);
    gltf_["bufferViews"].push_back(view);
    return gltf_["bufferViews"].size() - 1;
  }

  size_t addAccessor(json accessor) {
    gltf_["accessors"].push_back(std::move(accessor));
    return gltf_["accessors"].size() - 1;
  }

  static json positionAccessor(const ScenePart& part, size_t count) {
    Vec3 lo = part.positions.front(), hi = lo;
    for (Vec3 p : part.positions) {
      lo = ff::min(lo, p);
      hi = ff::max(hi, p);
    }
    return {{"componentType", kFloat}, {"count", count}, {"type", "VEC3"}, {"min", triple(lo)}, {"max", triple(hi)}};
  }

  Result<json> writePlain(const ScenePart& part) {
    static_assert(sizeof(Vec3) == 3 * sizeof(float));
    json position = positionAccessor(part, part.positions.size());
    position["bufferView"] = addView(part.positions.data(), part.positions.size() * sizeof(Vec3), kVertices);
    json index = {{"count", part.indices.size()}, {"type", "SCALAR"}};
    if (part.positions.size() < 65535) {
      std::vector<uint16_t> narrow;
      for (uint32_t i : part.indices) narrow.push_back(static_cast<uint16_t>(i));
      index["componentType"] = kUint16;
      index["bufferView"] = addView(narrow.data(), narrow.size() * sizeof(uint16_t), kIndices);
    } else {
      index["componentType"] = kUint32;
      index["bufferView"] = addView(part.indices.data(), part.indices.size() * sizeof(uint32_t), kIndices);
    }
    const size_t position_id = addAccessor(position);
    return json{{"attributes", {{"POSITION", position_id}}}, {"indices", addAccessor(index)}, {"material", part.material}};
  }

  Result<json> writeDraco(const ScenePart& part) {
    const auto draco = compress(part, model_.integer_grid, bounds_);
    if (!draco) return draco.error();
    const size_t position_id = addAccessor(positionAccessor(part, draco->vertices));
    const size_t index_id = addAccessor({{"componentType", kUint32}, {"count", part.indices.size()}, {"type", "SCALAR"}});
    const json extension = {{"bufferView", addView(draco->bytes.data(), draco->bytes.size(), 0)},
                            {"attributes", {{"POSITION", draco->attribute}}}};
    return json{{"attributes", {{"POSITION", position_id}}},
                {"indices", index_id},
                {"material", part.material},
                {"extensions", {{"KHR_draco_mesh_compression", extension}}}};
  }

  Result<std::vector<uint8_t>> container() {
    std::string text = gltf_.dump();
    text.resize((text.size() + 3) / 4 * 4, ' ');
    bin_.resize((bin_.size() + 3) / 4 * 4);
    const uint64_t total = 12 + 8 + text.size() + 8 + bin_.size();
    if (total > std::numeric_limits<uint32_t>::max())
      return cannot("the scene needs " + std::to_string(total) + " bytes, a .glb holds 4 GiB",
                    "use --draco, --merge or fewer patches");
    std::vector<uint8_t> out;
    out.reserve(total);
    const auto u32 = [&out](size_t v) {
      for (int i = 0; i < 4; ++i) out.push_back(static_cast<uint8_t>(v >> (8 * i)));
    };
    u32(0x46546c67);  // "glTF"
    u32(2);
    u32(total);
    u32(text.size());
    u32(0x4e4f534a);  // "JSON"
    out.insert(out.end(), text.begin(), text.end());
    u32(bin_.size());
    u32(0x004e4942);  // "BIN"
    out.insert(out.end(), bin_.begin(), bin_.end());
    return out;
  }

  const SceneModel& model_;
  GlbOptions options_;
  Bounds bounds_;
  json gltf_;
  std::vector<uint8_t> bin_;
  bool emissive_ = false;
};

}  // namespace

Result<std::vector<uint8_t>> glbBytes(const SceneModel& model, const GlbOptions& options) {
  return GlbBuilder(model, options).build();
}

Result<void> writeGlb(const SceneModel& model, const std::string& path, const GlbOptions& options) {
  auto bytes = glbBytes(model, options);
  if (!bytes) return bytes.error();
  std::ofstream out(path, std::ios::binary | std::ios::trunc);
  out.write(reinterpret_cast<const char*>(bytes->data()), static_cast<std::streamsize>(bytes->size()));
  out.close();
  if (!out) return Error{ErrorCode::kIo, path, "", "cannot write the file", "check the folder and the free space"};
  return {};
}

}  // namespace ff::tools
