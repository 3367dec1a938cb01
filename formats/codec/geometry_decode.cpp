#include <draco/compression/mesh/mesh_sequential_decoder.h>

#include <array>
#include <cmath>
#include <exception>
#include <memory>
#include <string>

#include "formats/codec/geometry.h"
#include "formats/codec/records.h"

namespace ff::formats {
namespace {

Error broken(const std::string& message) {
  return {ErrorCode::kInvalidFile, "", "", message, "restore this file from a copy, or bake again"};
}

// Draco's own, which stops before it takes memory for anything but what FORMAT.md section 5 lists: Draco bounds the number of faces and points by
// the bytes that are there, but a file may ask for any number of attributes a point.
class GeometryDecoder final : public draco::MeshSequentialDecoder {
 public:
  explicit GeometryDecoder(uint32_t triangles) : triangles_(triangles) {}
  const std::string& fault() const { return fault_; }

 protected:
  bool DecodeAllAttributes() override {
    const draco::PointAttribute* position = mesh()->GetNamedAttribute(draco::GeometryAttribute::POSITION);
    const draco::PointAttribute* patch = mesh()->GetNamedAttribute(draco::GeometryAttribute::GENERIC);
    if (mesh()->num_faces() != triangles_ || mesh()->num_points() > uint64_t{3} * triangles_)
      fault_ = "geometry has " + std::to_string(mesh()->num_faces()) + " triangles instead of " + std::to_string(triangles_);
    else if (mesh()->num_attributes() != 2 || position == nullptr || position->data_type() != draco::DT_FLOAT32 ||
             position->num_components() != 3 || patch == nullptr || patch->data_type() != draco::DT_UINT8 || patch->num_components() != 1)
      fault_ = "geometry has other attributes than positions and patch numbers";
    return fault_.empty() && MeshSequentialDecoder::DecodeAllAttributes();
  }

 private:
  const uint32_t triangles_;
  std::string fault_;
};

}  // namespace

// Draco sees bytes only after their checksum has passed; its exceptions end here all the same.
Result<void> decodeGeometry(std::span<const std::byte> payload, uint32_t triangles, uint32_t nodes,
                            TileGeometry& out) try {
  out.positions.clear();
  out.patch.clear();
  if (triangles == 0) {
    if (!payload.empty()) return broken("empty geometry has a payload");
    return {};
  }
  if (triangles > kMaxGeometryTriangles) return broken("geometry has too many triangles");
  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char*>(payload.data()), payload.size());
  draco::DecoderBuffer head(buffer);
  draco::DracoHeader header;
  if (const auto ok = draco::PointCloudDecoder::DecodeHeader(&head, &header); !ok.ok()) return broken(std::string("Draco: ") + ok.error_msg());
  if (header.encoder_type != draco::TRIANGULAR_MESH || header.encoder_method != draco::MESH_SEQUENTIAL_ENCODING ||
      (header.flags & METADATA_FLAG_MASK) != 0)
    return broken("geometry is not a mesh in Draco's sequential encoding, without metadata");
  const auto mesh = std::make_unique<draco::Mesh>();
  GeometryDecoder decoder(triangles);
  const draco::Status decoded = decoder.Decode(draco::DecoderOptions(), &buffer, mesh.get());
  if (!decoded.ok()) return broken(decoder.fault().empty() ? std::string("Draco: ") + decoded.error_msg() : decoder.fault());
  const draco::PointAttribute* position = mesh->GetNamedAttribute(draco::GeometryAttribute::POSITION);
  const draco::PointAttribute* patch = mesh->GetNamedAttribute(draco::GeometryAttribute::GENERIC);
  out.positions.reserve(size_t{3} * triangles);
  out.patch.reserve(triangles);
  const auto valueOf = [&](const draco::PointAttribute& a, draco::PointIndex p) {
    const draco::AttributeValueIndex v = a.mapped_index(p);
    return v.value() < a.size() ? v : draco::kInvalidAttributeValueIndex;
  };
  for (uint32_t f = 0; f < triangles; ++f) {
    const draco::Mesh::Face& face = mesh->face(draco::FaceIndex(f));
    for (const draco::PointIndex& point : face) {
      if (point.value() >= mesh->num_points()) return broken("geometry names a point that does not exist");
      const auto p = valueOf(*position, point), q = valueOf(*patch, point);
      if (p == draco::kInvalidAttributeValueIndex || q == draco::kInvalidAttributeValueIndex)
        return broken("geometry names a value that does not exist");
      std::array<float, 3> xyz{};
      uint8_t index = 0;
      position->GetValue(p, xyz.data());
      patch->GetValue(q, &index);
      if (!std::isfinite(xyz[0]) || !std::isfinite(xyz[1]) || !std::isfinite(xyz[2]))
        return broken("geometry has a position that is not finite");
      if (index >= nodes) return broken("geometry names a patch that the tile does not have");
      if (&point == &face[0]) out.patch.push_back(index);
      if (index != out.patch.back()) return broken("a triangle belongs to two patches");
      out.positions.push_back({xyz[0], xyz[1], xyz[2]});
    }
  }
  return {};
} catch (const std::exception& e) {
  return broken(std::string("Draco: ") + e.what());
}

}  // namespace ff::formats
