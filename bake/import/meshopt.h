// EXT_meshopt_compression. Private to this folder.
#pragma once
#include "bake/import/validate.h"

namespace ff::bake::gltf {

// Decodes compressed bufferViews into buffers of their own and points the views there. Views with a filter for normals,
// rotations or colours keep their fallback buffer, which may be absent.
void decodeMeshoptViews(const Item& file, Storage& storage, Budget& budget);

}  // namespace ff::bake::gltf
