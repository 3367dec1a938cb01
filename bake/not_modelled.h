// What a file asks for and a bake leaves out, changes or stands something in for: one line each, with how much of the
// scene it is and the names of the materials.
#pragma once
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "bake/scene.h"

namespace ff::bake {

struct NotModelled {
  std::string what;                // "KHR_materials_clearcoat: the coat's reflection is left out"
  uint64_t triangles = 0;          // of the scene; none where it is no matter of surfaces
  double area_share = 0;           // of the scene's surface
  std::vector<std::string> names;  // of materials, each once, largest area first
};

// Of the materials of the scene's triangles, and of those whose triangles were all left out for letting light pass; then
// of the scene as a whole.
std::vector<NotModelled> notModelled(const Scene& scene);

class PatchSet;
// Of patches whose albedo was lowered (kMaxReflected), by index into set.patches; nothing for none.
std::optional<NotModelled> loweredAlbedos(const Scene& scene, const PatchSet& set, std::span<const uint32_t> patches);

}  // namespace ff::bake
