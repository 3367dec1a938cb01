// Where a group's rays went and what it was that they met, as the bake cache keeps it: while that is as it was, they find the same again.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "bake/light/hit_rows.h"
#include "bake/plan/contents.h"
#include "bake/rays/ray_trail.h"
#include "formats/codec/bytes.h"

namespace ff::bake {

struct KeptTrail {
  CubeBox box;                       // that of then, which may not be today's
  Sides left;                        // RayTrail::left()
  std::vector<CubesOfBlock> passed;  // RayTrail::passed()
  std::vector<uint64_t> met;         // cubes of 2^kMetLog cells that patches lie in which were hit, by Hilbert key, ascending
  Digest seen{};                     // of all of it
};

// rows: what the rays hit.
KeptTrail keptTrail(const RayTrail& rays, const HitRows& rows, const PatchSet& set, const Contents& contents);
// Of rays towards lamps, of groups whose rows' rays have left `rows`, as long as that is as it was: the cubes that it has not got. more: what others of the
// group have left, in today's box, or null.
KeptTrail keptBeyond(const KeptTrail& rows, const RayTrail& rays, const KeptTrail* more, const Contents& contents);
// Whether nothing has changed where the rays went.
bool isAsItWas(const KeptTrail& trail, const Contents& contents);

// As bytes, those of a unit's groups together: what several have met is told once.
void putTrails(formats::ByteWriter& out, std::span<const KeptTrail* const> trails);
// So many trails; none where it is not what putTrails() writes.
std::vector<KeptTrail> takeTrails(formats::ByteReader& in, size_t trails);

}  // namespace ff::bake
