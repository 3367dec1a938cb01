// A scene as it is exported made a scene as it is baked: some objects are left out or treated apart, by name; a sky dome goes; what
// lies twice at one place counts once; the backs of single-sided surfaces do what they are asked to.
#pragma once
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bake/finding.h"
#include "bake/scene.h"

namespace ff::bake {

struct CleanupSettings {
  // Patterns (see matching()) of nodes, meshes and materials: left out; only in the light's way, without patches; with patches
  // 1 / density as long as elsewhere; of several patterns that match the last counts.
  std::vector<std::string> exclude{}, occlude_only{};
  std::vector<std::pair<std::string, float>> density{};
  bool keep_sky_dome = false;
  Backs backs = Backs::kAbsorb;
};

struct Cleanup {
  std::optional<Scene> scene;         // empty: the scene is right as it is
  std::vector<Finding> findings;      // what was done that was not asked for
};

// Errors (kUsage): a pattern that nothing matches, a density out of range. The content hash of a scene that comes out covers what was done.
Result<Cleanup> cleanUp(const Scene& whole, const CleanupSettings& settings);

}  // namespace ff::bake
