// What a file asks for and a bake leaves out, changes or stands something in for: a finding each, with how much of the scene it is and a place for
// each material, the largest first.
#pragma once
#include <optional>
#include <span>
#include <vector>

#include "bake/finding.h"
#include "bake/scene.h"

namespace ff::bake {

// Of the materials of the scene's triangles, and of those whose triangles were all left out for letting light pass; then
// of the scene as a whole, which counts nothing.
std::vector<Finding> notModelled(const Scene& scene);

class PatchSet;
// Of patches whose albedo was lowered (kMaxReflected), by index into set.patches; nothing for none.
std::optional<Finding> loweredAlbedos(const Scene& scene, const PatchSet& set, std::span<const uint32_t> patches);

}  // namespace ff::bake
