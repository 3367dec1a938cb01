// A bake that stays on disk and is used again.
#pragma once
#include <string>

#include "bake/bake.h"

namespace ff::chart {

struct KeptBake {
  std::string path;     // of the world
  double seconds = 0;   // that the bake took, when it was made
  bool made = false;    // now
};

// Bakes a scene into `path`, whose folder is made if there is none. A world that lies there already is taken if it is the
// same bake of the same file (WorldInfo::bake_key; scenes that were never a file are baked anew). Errors: those of the bake.
Result<KeptBake> keptBake(const bake::Scene& scene, const bake::BakeSettings& settings, const std::string& path);

}  // namespace ff::chart
