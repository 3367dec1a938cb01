// The rays of a bake as units of work: those of a range of patches that are cast together (castRanges), whose hits are kept in the bake cache
// with where the rays went. A unit is clean, and its hits are taken from there, while nothing has changed in the cubes that its rays passed
// through, nor the patches that they met; the bytes are those of casting it again.
#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "bake/light/form_factor.h"
#include "bake/plan/cache.h"
#include "bake/plan/contents.h"
#include "bake/plan/ranks.h"

namespace ff::bake {

// What the cache has of a unit.
enum class UnitState : uint8_t {
  kMissing,  // nothing was ever cast from this surface, with these settings and lamps
  kStale,    // something has changed where its rays went
  kClean
};

struct UnitCounts {
  uint64_t clean = 0, stale = 0, missing = 0;
  uint64_t clean_rays = 0;  // of clean units
  uint64_t by_others = 0;   // of those that were not clean: cast by other ranks
  uint64_t units() const { return clean + stale + missing; }
};

class RayUnits {
 public:
  // All outlive it. budget, seed: castRows().
  RayUnits(const Scene& scene, const PatchSet& set, RayBudget budget, uint64_t seed, BakeCache& cache);

  // The same as castRows(), and what the cache had. Hits of units that it had are not cast; those of others are stored. Memory: a bit a cube of
  // Contents::box() for each thread, 8 bytes for each cube of it that holds anything, and castRows()'s.
  // ranks: others that help, or null.
  void cast(const RayCaster& caster, WorkCount& done, UnitCounts& counts, const TakeRows& take, Ranks* ranks = nullptr);

  // On the other ranks: casts units that rank 0's cast() gives, into the cache, until there are no more.
  void help(const RayCaster& caster, WorkCount& done, Ranks& ranks);

  // What cast() would find. changed: middles of the blocks of cubes whose contents have changed since cast() last came to its end with these settings, m.
  UnitCounts status(WorkCount& done, std::vector<Vec3>& changed);

 private:
  size_t units() const { return start_.size() - 1; }
  UnitState load(size_t unit, HitRows* rows) const;  // rows: null: only the state is asked for
  std::vector<std::byte> encode(const HitRows& rows, const RayTrail& trail) const;
  class Casting;

  const Scene& scene_;
  const PatchSet& set_;
  const RayBudget budget_;
  const uint64_t seed_;
  BakeCache& cache_;
  const Contents contents_;
  const std::vector<uint32_t> start_;
  Digest settings_{};           // the same for all units: the key of what all of the world held
  std::vector<Digest> keys_;    // by unit
};

}  // namespace ff::bake
