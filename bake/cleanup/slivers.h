// Triangles that are of no use: of no area, or too thin for rays to start from and for their normals to be right.
#pragma once
#include <optional>

#include "bake/finding.h"
#include "bake/scene.h"

namespace ff::bake {

// Modelling leaves a few in most scenes, and nobody misses them; more than kFewSlivers of all triangles tell of a faulty export, or of units of the wrong
// size. A sliver is lower than rays start off a surface. Those without area the importer has left out.
inline constexpr double kFewSlivers = 0.01;
std::optional<Finding> findSlivers(const Scene& scene);

}  // namespace ff::bake
