// Lamps that are modelled in the plane of what they are fixed to: a panel of a ceiling that has no hole for it, a screen on its cabinet, two tubes that
// overlap. Which of the two a ray meets rounding would decide, and the part that both have would shine twice.
#pragma once
#include <cstdint>
#include <vector>

#include "bake/scene.h"
#include "formats/result.h"

namespace ff::bake {

struct Lift {
  uint32_t triangle;
  Vec3 by;  // m
};

// Triangles that emit and lie in one plane with others that they cover in part and that face the same way, ascending; and how they are to be moved so that they
// lie on these, as a picture on its wall: by a few units in the last place of their coordinates. Of two that emit the brighter lies above, then the one that comes
// first. Linear in the number of triangles, where lamps do not crowd. On all of TBB's threads. Errors: kIo (Embree).
Result<std::vector<Lift>> findLampsInPlane(const Scene& scene);

}  // namespace ff::bake
