// What a bake will come to, before it is begun: a patch size that is a little too small asks for more memory than any machine has.
#pragma once
#include <cstdint>
#include <string>

#include "bake/bake.h"

namespace ff::bake {

// From areas and boxes alone, in one pass over the triangles. cell_m: the patch size; 0: as the budget asks.
BakeEstimate estimateBake(const Scene& scene, const BakeSettings& settings);

// Refuses (kUsage) what does not fit into settings.memory_bytes, or into what is free where that is 0, and says which size would.
Result<void> checkFits(const Scene& scene, const BakeSettings& settings, const BakeEstimate& estimate);

// The pieces of surface that memory has room for, within a tenth.
double piecesThatFit(const Scene& scene, const BakeSettings& settings);

// Refuses (kIo) a world that its disk has no room for. What cannot be found out is not refused.
Result<void> checkSpace(const std::string& path, const BakeEstimate& estimate);

}  // namespace ff::bake
