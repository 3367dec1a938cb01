#include "bake/import/draco.h"

#include <draco/compression/mesh/mesh_edgebreaker_decoder.h>
#include <draco/compression/mesh/mesh_sequential_decoder.h>

#include "formats/result.h"

namespace ff::bake::gltf {
namespace {

const char* const kCompressAgain = "compress the mesh again";

uint64_t number(const tinygltf::Value& object, const char* key) {
  return static_cast<uint64_t>(object.Get(key).GetNumberAsDouble());
}

// Counts in the bitstream's own header, where its layout is the one of version 2.2 without metadata; Draco allocates by
// them before it has seen the data. (Draco Bitstream Specification 2.2, sections 2-4.)
struct HeaderCounts {
  bool known = false;
  uint64_t faces = 0, vertices = 0;
};

HeaderCounts peek(const Bytes& bytes) {
  constexpr uint64_t kHeader = 11;
  HeaderCounts out;
  if (bytes.size < kHeader + 1 || bytes.data[5] != 2 || bytes.data[6] < 2) return out;
  const bool metadata = bytes.data[10] & 0x80;  // high byte of the flags
  const bool edgebreaker = bytes.data[8] == 1;
  if (metadata) return out;
  uint64_t at = kHeader + (edgebreaker ? 1 : 0);
  const auto varint = [&](uint64_t* value) {
    *value = 0;
    for (uint32_t shift = 0; shift < 35; shift += 7) {
      if (at >= bytes.size) return false;
      const uint8_t byte = bytes.data[at++];
      *value |= uint64_t{byte & 0x7fu} << shift;
      if (!(byte & 0x80)) return true;
    }
    return false;
  };
  // Edgebreaker: vertices, then faces; sequential: faces, then points.
  out.known = edgebreaker ? varint(&out.vertices) && varint(&out.faces) : varint(&out.faces) && varint(&out.vertices);
  return out;
}

// Draco's own, which stops before its attributes, of which a file may ask for any number a vertex, take more than `max_bytes`.
template <class Base>
class CappedDecoder final : public Base {
 public:
  CappedDecoder(uint64_t max_bytes, uint64_t* bytes) : max_bytes_(max_bytes), bytes_(bytes) {}

 protected:
  bool DecodeAllAttributes() override {
    uint64_t a_point = 0;  // the values, and as integers while they are decoded
    for (int32_t i = 0; i < this->mesh()->num_attributes(); ++i) {
      const draco::PointAttribute& attribute = *this->mesh()->attribute(i);
      a_point += static_cast<uint64_t>(attribute.byte_stride()) + uint64_t{attribute.num_components()} * sizeof(int32_t);
    }
    *bytes_ = a_point * this->mesh()->num_points();
    return *bytes_ <= max_bytes_ && Base::DecodeAllAttributes();
  }

 private:
  const uint64_t max_bytes_;
  uint64_t* const bytes_;
};

// attribute_bytes: what its attributes ask for, in any case.
draco::Status decodeMesh(draco::DecoderBuffer& buffer, uint64_t max_bytes, draco::Mesh& mesh, uint64_t& attribute_bytes) {
  draco::DecoderBuffer head(buffer);
  draco::DracoHeader header;
  if (auto ok = draco::PointCloudDecoder::DecodeHeader(&head, &header); !ok.ok()) return ok;
  if (header.encoder_type != draco::TRIANGULAR_MESH) return draco::Status(draco::Status::DRACO_ERROR, "the data is no triangle mesh");
  if (header.encoder_method == draco::MESH_SEQUENTIAL_ENCODING)
    return CappedDecoder<draco::MeshSequentialDecoder>(max_bytes, &attribute_bytes).Decode({}, &buffer, &mesh);
  if (header.encoder_method == draco::MESH_EDGEBREAKER_ENCODING)
    return CappedDecoder<draco::MeshEdgebreakerDecoder>(max_bytes, &attribute_bytes).Decode({}, &buffer, &mesh);
  return draco::Status(draco::Status::DRACO_ERROR, "unknown method");
}

Elements decodeAttribute(const draco::Mesh& mesh, const std::string& name, uint32_t id, bool normalized,
                         const std::string& place, Budget& budget) {
  const draco::PointAttribute* attribute = mesh.GetAttributeByUniqueId(id);
  if (!attribute) refuse(place, name + ": the Draco data has no attribute with id " + std::to_string(id), kCompressAgain);
  const uint32_t components = name == "POSITION"  ? 3
                              : name == "COLOR_0" ? static_cast<uint32_t>(attribute->num_components())
                                                  : 2;
  if (static_cast<uint32_t>(attribute->num_components()) != components || components < (name == "COLOR_0" ? 3 : 2) || components > 4)
    refuse(place, name + ": the Draco attribute has " + std::to_string(attribute->num_components()) + " components",
           kCompressAgain);
  budget.take(uint64_t{mesh.num_points()} * components * sizeof(float), place);
  std::vector<float> values(size_t{mesh.num_points()} * components);
  for (uint32_t p = 0; p < mesh.num_points(); ++p) {
    const draco::AttributeValueIndex value = attribute->mapped_index(draco::PointIndex(p));
    if (value.value() >= attribute->size())
      refuse(place, name + ": Draco vertex " + std::to_string(p) + " has no value", kCompressAgain);
    if (!attribute->ConvertValue<float>(value, static_cast<int8_t>(components), &values[size_t{p} * components]))
      refuse(place, name + ": the Draco attribute cannot be read as numbers", kCompressAgain);
  }
  // What the accessor says counts; Draco's own flag, where it is set, has been followed already.
  if (normalized && !attribute->normalized()) {
    const float largest = attribute->data_type() == draco::DT_UINT8    ? 255.0f
                          : attribute->data_type() == draco::DT_INT8   ? 127.0f
                          : attribute->data_type() == draco::DT_UINT16 ? 65535.0f
                          : attribute->data_type() == draco::DT_INT16  ? 32767.0f
                                                                       : 1.0f;
    for (float& v : values) v /= largest;
  }
  return Elements(std::move(values), components, place + ": Draco " + name);
}

}  // namespace

DracoMesh decodeDraco(const Document& document, const tinygltf::Value& extension, int mode, const std::string& place,
                      Budget& budget) {
  const Bytes bytes = viewBytes(document, static_cast<int>(number(extension, "bufferView")), place);
  const uint64_t vertex_count = number(extension, "vertexCount"), index_count = number(extension, "indexCount");
  const HeaderCounts header = peek(bytes);
  // Decoding keeps corner tables and attribute buffers beside the mesh: about 200 bytes a triangle.
  constexpr uint64_t kBytesPerFace = 200;
  const uint64_t faces = header.known ? header.faces : index_count / 3;
  budget.take(faces * kBytesPerFace, place);
  if (header.known && (header.vertices > 3 * header.faces))
    refuse(place,
           "Draco header: " + std::to_string(header.vertices) + " vertices for " + std::to_string(header.faces) +
               " triangles",
           kCompressAgain);
  if (mode == 4 && index_count && header.known && header.faces * 3 != index_count)
    refuse(place,
           "the index accessor counts " + std::to_string(index_count) + ", the Draco data holds " +
               std::to_string(header.faces) + " triangles",
           kCompressAgain);

  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char*>(bytes.data), bytes.size);
  draco::Mesh mesh;
  uint64_t attribute_bytes = 0;
  const draco::Status decoded = decodeMesh(buffer, budget.left(), mesh, attribute_bytes);
  budget.take(attribute_bytes, place);  // refuses what was too much
  if (!decoded.ok()) refuse(place, "Draco: " + printable(decoded.error_msg_string()), kCompressAgain);

  DracoMesh out;
  out.vertex_count = mesh.num_points();
  if (out.vertex_count != vertex_count)
    refuse(place,
           "the accessors count " + std::to_string(vertex_count) + " vertices, the Draco data holds " +
               std::to_string(out.vertex_count),
           kCompressAgain);
  out.triangles.reserve(mesh.num_faces());
  for (uint32_t f = 0; f < mesh.num_faces(); ++f) {
    const draco::Mesh::Face& face = mesh.face(draco::FaceIndex(f));
    std::array<uint32_t, 3> triangle{};
    for (size_t k = 0; k < 3; ++k) {
      triangle[k] = face[k].value();
      if (triangle[k] >= out.vertex_count)
        refuse(place,
               "Draco triangle " + std::to_string(f) + " refers to vertex " + std::to_string(triangle[k]) + " of " +
                   std::to_string(out.vertex_count),
               kCompressAgain);
    }
    out.triangles.push_back(triangle);
  }
  const tinygltf::Value& ids = extension.Get("attributes");
  for (const std::string& name : ids.Keys()) {
    const bool normalized = extension.Has("normalized") && extension.Get("normalized").Has(name);
    out.attributes.emplace(
        name, decodeAttribute(mesh, name, static_cast<uint32_t>(number(ids, name.c_str())), normalized, place, budget));
  }
  budget.give(faces * kBytesPerFace + attribute_bytes);
  for (const auto& [name, elements] : out.attributes)
    budget.give(elements.count() * elements.components() * sizeof(float));
  return out;
}

}  // namespace ff::bake::gltf
