// Drawing geometry of a tile as a Draco mesh: sequential connectivity, so that triangles keep their order; positions
// quantised to 16 bits over the mesh's extent; a generic uint8 attribute holds the patch. Draco has no checksum of its
// own: the strip's header carries one.
#pragma once
#include <cstddef>
#include <span>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"

namespace ff::formats {

inline constexpr int kGeometryBits = 16;

// Reading library. `triangles` is the number that the strip's header promises; patches are checked against `nodes`.
Result<void> decodeGeometry(std::span<const std::byte> payload, uint32_t triangles, uint32_t nodes, TileGeometry& out);
// Writing library.
Result<std::vector<std::byte>> encodeGeometry(const TileGeometry& geometry);

}  // namespace ff::formats
