#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>

#include <cmath>
#include <exception>
#include <string>

#include "formats/codec/geometry.h"
#include "formats/codec/records.h"

namespace ff::formats {
namespace {

Error unfit(const TileGeometry& g, const std::string& message) {
  return {ErrorCode::kPhysics, "", "geometry of tile " + std::to_string(g.tile), message, ""};
}

}  // namespace

Result<std::vector<std::byte>> encodeGeometry(const TileGeometry& g) try {
  const size_t triangles = g.patch.size();
  if (g.positions.size() != 3 * triangles) return unfit(g, "positions are not three per triangle");
  if (g.sealed > triangles) return unfit(g, "has more sealed triangles than triangles");
  if (triangles > kMaxGeometryTriangles) return unfit(g, "has too many triangles");
  for (const Vec3& p : g.positions)
    if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) return unfit(g, "a position is not finite");
  if (triangles == 0) return std::vector<std::byte>{};

  draco::TriangleSoupMeshBuilder builder;
  builder.Start(static_cast<int>(triangles));
  const int position = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  const int patch = builder.AddAttribute(draco::GeometryAttribute::GENERIC, 1, draco::DT_UINT8);
  for (size_t t = 0; t < triangles; ++t) {
    const draco::FaceIndex face(static_cast<uint32_t>(t));
    const Vec3* p = g.positions.data() + 3 * t;
    builder.SetAttributeValuesForFace(position, face, &p[0].x, &p[1].x, &p[2].x);
    builder.SetAttributeValuesForFace(patch, face, &g.patch[t], &g.patch[t], &g.patch[t]);
  }
  const std::unique_ptr<draco::Mesh> mesh = builder.Finalize();
  if (!mesh) return unfit(g, "Draco cannot build the mesh");
  const auto encode = [&](bool compress_connectivity) -> Result<std::vector<std::byte>> {
    draco::Encoder encoder;
    encoder.SetEncodingMethod(draco::MESH_SEQUENTIAL_ENCODING);
    encoder.SetSpeedOptions(3, 3);
    encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, kGeometryBits);
    encoder.options().SetGlobalBool("compress_connectivity", compress_connectivity);
    draco::EncoderBuffer buffer;
    if (const draco::Status status = encoder.EncodeMeshToBuffer(*mesh, &buffer); !status.ok())
      return unfit(g, std::string("Draco: ") + status.error_msg());
    const auto* bytes = reinterpret_cast<const std::byte*>(buffer.data());
    return std::vector<std::byte>(bytes, bytes + buffer.size());
  };
  // Draco's decoder refuses a mesh whose bytes after the header and the counts are fewer than three a face, although
  // compressed connectivity may take less (flat, regular floors do). Plain connectivity never does.
  constexpr size_t kHeaderBytes = 32;  // of Draco's header and counts, at most
  auto encoded = encode(true);
  return encoded && encoded->size() < 3 * triangles + kHeaderBytes ? encode(false) : std::move(encoded);
} catch (const std::exception& e) {
  return unfit(g, std::string("Draco: ") + e.what());
}

}  // namespace ff::formats
