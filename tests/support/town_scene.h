// A town of tools/scene as the baker imports it.
#pragma once
#include <stdexcept>
#include <utility>

#include "bake/import/gltf_import.h"
#include "tests/support/random_world.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace ff::bake::test {

// Writes town.glb into the folder. Throws std::runtime_error.
inline Scene townScene(const formats::TemporaryFolder& folder, uint64_t patches) {
  const auto made = tools::makeTown({.patches = patches});
  if (!made) throw std::runtime_error(made.error().line());
  if (auto written = tools::writeGlb(tools::townModel(*made, false), folder.file("town.glb")); !written) throw std::runtime_error(written.error().line());
  auto scene = importGltf(folder.file("town.glb"));
  if (!scene) throw std::runtime_error(scene.error().line());
  return std::move(*scene);
}

}  // namespace ff::bake::test
