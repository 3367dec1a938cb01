// A world of several files: one scene of all of them.
#pragma once
#include <array>
#include <span>
#include <string>
#include <vector>

#include "bake/import/gltf_import.h"

namespace ff::bake {

struct SceneFile {
  std::string path;
  std::array<double, 16> placed = ImportLimits{}.placed;
};

// What is named on a command line. A folder stands for the .glb and .gltf files in it, ascending by name; a .json file for the files and folders that it lists,
// {"files": ["a.glb", {"path": "b.glb", "translation": [100, 0, 0]}]}, each with a glTF node's matrix, or translation (m), rotation and scale, and paths that
// start from the list's folder; another file for itself. Errors: kIo (a file that cannot be read, a folder that holds no scene), kInvalidFile (a list).
Result<std::vector<SceneFile>> sceneFiles(std::span<const std::string> paths);

// The scenes of files in one space, as if they were one: in their order, named after the first. A picture that several files hold is kept once;
// materials of one name are one lamp group, as within a file. limits: of each file, but for where it is placed; progress counts files where there are several.
// Errors: importGltf()'s; kUsage (no file; together more than 2^32 - 1 corners).
Result<Scene> importFiles(std::span<const SceneFile> files, const ImportLimits& limits = {});

}  // namespace ff::bake
