// What it costs to apply a tile to the cut: tiles of a baked town leave and enter the local matrix one at a time.
#pragma once
#include <string>

namespace ff::bench {

// Prints update.tile_apply_ms and update.tile_leave_ms. world: a baked world's path; empty: a town is made and baked.
void printTileApply(const std::string& world, bool quick);

}  // namespace ff::bench
