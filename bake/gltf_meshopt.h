// EXT_meshopt_compression. Private to gltf_*.cpp.
#pragma once
#include "bake/gltf_reduce.h"

namespace ff::bake::gltf {

// Decodes every compressed bufferView into a buffer of its own and points the view there. A view that the library at hand
// cannot decode keeps its fallback buffer; one without data is refused later, when something reads it.
void decodeMeshoptViews(const Item& file, Storage& storage, Budget& budget);

}  // namespace ff::bake::gltf
