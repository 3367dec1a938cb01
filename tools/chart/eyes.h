// Where the eyes are from which a world is scored.
#pragma once
#include <string>
#include <vector>

#include "formats/read/whole_world.h"


namespace ff::chart {

inline constexpr int kEyes = 8;

// Along a camera path, evenly over its time, both ends as well. camera: a file, or empty: the path that ffview would find in
// the world. Errors: those of the file; a world without drawing geometry.
Result<std::vector<Vec3>> eyesOf(const std::string& camera, const formats::WholeWorld& world, int count = kEyes);

}  // namespace ff::chart
