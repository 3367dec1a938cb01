// What a bake will come to, before it is begun: a patch size that is a little too small asks for more memory than any machine has.
#pragma once
#include <cstdint>
#include <string>

#include "bake/bake.h"

namespace ff::bake {

// From areas and boxes alone, in one pass over the triangles. cell_m: the patch size; 0: as the budget asks.
BakeEstimate estimateBake(const Scene& scene, const BakeSettings& settings);

// Refuses (kUsage) a bake of more pieces than kMostPieces (patches.h), and one that takes more than settings.memory_bytes, or than what is free where that is 0, whatever it puts into files; says which size would
// take less.
Result<void> checkFits(const Scene& scene, const BakeSettings& settings, const BakeEstimate& estimate);

// Refuses (kIo) a world that its disk has no room for, together with what memory has none for. What cannot be found out is not refused.
Result<void> checkSpace(const std::string& path, const BakeSettings& settings, const BakeEstimate& estimate);

}  // namespace ff::bake
