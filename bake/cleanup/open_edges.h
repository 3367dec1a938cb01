// Holes and cracks in surface that is meant to be closed: light gets through them to backs, and ends there.
#pragma once
#include <optional>

#include "bake/finding.h"
#include "bake/rays/ray_caster.h"
#include "bake/scene.h"
#include "bake/work_count.h"

namespace ff::bake {

// Edges that one triangle alone uses once equal positions are one. Surface may be open, so they are worth a line only where it is single-sided and
// nearly closed: connected surface of whose edges at most kMaxOpen are open, by length, and whose holes together are at most kMaxHole of its area.
// Nothing is said of
// - corners on others' edges, and gaps that rounding leaves;
// - openings of a room, whose surface faces inward: windows and doors. A crack, which is a gap of a perimeter long for its area (kCrack), is none;
// - holes that something covers: what stands on a floor without an underside, or with an end in another solid. A few rays tell, at most kSamples a hole;
// - the border of a piece of ground: its underside, of kGround of the scene's breadth, and what its sides cut.
// Linear in the scene; up to 60 bytes a triangle meanwhile. stop: see WorkCount.
inline constexpr double kMaxOpen = 0.3, kMaxHole = 0.25, kCrack = 0.05, kGround = 0.9;
inline constexpr uint32_t kSamples = 8;
std::optional<Finding> findOpenEdges(const Scene& scene, const RayCaster& caster, WorkCount& stop);

}  // namespace ff::bake
