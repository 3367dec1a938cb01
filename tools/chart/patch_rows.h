// All rows of a scene's patches in memory, without levels or files: what too few rays or too large patches do is seen
// here, where nothing else errs.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "bake/matrix/pool.h"
#include "bake/rays/ray_caster.h"
#include "bake/surface/patches.h"

namespace ff::chart {

struct PatchRows {
  std::vector<uint64_t> start{0};
  std::vector<uint32_t> column;
  std::vector<float> f;    // form factors
  std::vector<float> sky;   // fraction of the hemisphere that is sky, per patch; of all rays
  std::vector<Vec3> lamps;  // irradiance from what patches emit, W/m2, likewise
};

// Rows from hits (bake::castRows), pooled from both ends. quanta: Q of row sampling; 0: the pooled rows themselves.
PatchRows pooledRows(const bake::PatchSet& set, bake::HitRows hits, uint32_t quanta);

// B of B = M + albedo F B by Jacobi iterations in double precision, 3 values a patch: until the largest change is below
// tolerance times the largest B, or after `most` iterations.
std::vector<double> solveRows(const bake::PatchSet& set, const PatchRows& rows, std::span<const double> source,
                              double tolerance = 0, int most = 60);

// rho (sun + sky + lamps) of every patch, 3 values each; sun: irradiance of each patch; the sky's irradiance is 2 pi where
// all of it is seen.
std::vector<double> sunAndSky(const bake::PatchSet& set, const PatchRows& rows, std::span<const double> sun);

// Direct sunlight at the patches' centroids, W/m2: 10 facing the sun.
std::vector<double> sunOnPatches(const bake::PatchSet& set, const bake::RayCaster& caster);

// ||a - b|| / ||b||.
double reflectedDifference(std::span<const double> a, std::span<const double> b);

}  // namespace ff::chart
