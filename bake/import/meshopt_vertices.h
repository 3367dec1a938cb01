// Attribute streams of EXT_/KHR_meshopt_compression, versions 0 and 1 (Debian 12's meshoptimizer knows only version 0).
// Kapoulkine, A.; St. Pierre, J.; Knyazev, A.; McCurdy, D. KHR_meshopt_compression. 2025, appendix A, mode 0.
// Private to this folder.
#pragma once
#include <cstdint>
#include <span>

namespace ff::bake::gltf {

// Fills `out` with elements of `stride` bytes (4..256, a multiple of 4; out.size() is a multiple of it). False if the
// stream breaks a rule; `out` is then undefined.
bool decodeMeshoptVertices(std::span<const uint8_t> stream, uint64_t stride, std::span<uint8_t> out);

}  // namespace ff::bake::gltf
