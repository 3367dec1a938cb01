// A world of several files: one scene of all of them.
#pragma once
#include <span>
#include <string>
#include <vector>

#include "bake/import/gltf_import.h"

namespace ff::bake {

// A folder stands for the .glb and .gltf files in it, ascending by name; what is a file stays. Errors: kIo (a folder that cannot be listed, or
// holds no scene).
Result<std::vector<std::string>> sceneFiles(std::span<const std::string> paths);

// The scenes of files that share one space, as if they were one: in their order, named after the first. A picture that several files hold is kept once;
// materials of one name are one lamp group, as within a file. limits: of each file; progress counts files where there are several.
// Errors: importGltf()'s; kUsage (no file; together more than 2^32 - 1 corners).
Result<Scene> importFiles(std::span<const std::string> files, const ImportLimits& limits = {});

}  // namespace ff::bake
