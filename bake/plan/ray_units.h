// The rays of a bake as units of work: those of a range of patches (castRanges), whose hits are kept in the bake cache, one file a unit, group by
// group (castGroups) with where the group's rays went. A group's rows are clean, and its hits are taken from there, while nothing has changed in the cubes
// that its rays passed through, nor the patches that they met, but that these may cease to emit. The light of lamps, which rows do not depend on, is clean while the
// rows are, and the cubes that rays towards lamps passed through and the lamps that the patch's are aimed at are as they were; else it alone is cast again.
// The bytes are those of casting all of it again.
#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "bake/light/form_factor.h"
#include "bake/plan/cache.h"
#include "bake/plan/contents.h"
#include "bake/plan/lamp_digests.h"
#include "bake/plan/ranks.h"

namespace ff::bake {

// Patches by what the cache has of their rays.
struct CachedRays {
  struct Patches {
    uint64_t clean = 0, stale = 0;  // stale: something has changed where their rays went, or a lamp that may light them
    uint64_t missing = 0;           // nothing was ever cast from this surface, with these settings
  };
  Patches rows, lamps;            // lamps: their light
  uint64_t clean_rays = 0;        // of clean rows
  uint64_t by_others = 0;         // patches of units of which not all was clean: cast by other ranks
  uint64_t patches() const { return rows.clean + rows.stale + rows.missing; }
  CachedRays& operator+=(const CachedRays& more);
};

class RayUnits {
 public:
  struct Group;  // of a unit, as the cache keeps it

  // All outlive it. budget, seed: castRows().
  RayUnits(const Scene& scene, const PatchSet& set, const RayCaster& caster, RayBudget budget, uint64_t seed, BakeCache& cache);

  // The same as castRows(), and what the cache had. What it had is not cast; the rest is stored. Memory: two bits a cube of
  // Contents::box() for each thread, 8 bytes for each cube of it that holds anything, and castRows()'s.
  // ranks: others that help, or null.
  void cast(WorkCount& done, CachedRays& found, const TakeRows& take, Ranks* ranks = nullptr);

  // On the other ranks: casts units that rank 0's cast() gives, into the cache, until there are no more.
  void help(WorkCount& done, Ranks& ranks);

  // What cast() would find. changed: middles of the blocks of cubes whose contents have changed since cast() last came to its end with these settings, m.
  CachedRays status(WorkCount& done, std::vector<Vec3>& changed);

 private:
  class Casting;
  size_t units() const { return start_.size() - 1; }
  // A unit's groups as the cache has them; none: it has not got the unit.
  std::vector<Group> load(size_t unit) const;
  // LampDigests::of() by patch of a group, which begins with patch `first`.
  std::vector<uint64_t> lampDigests(uint32_t first, const GroupRows& cast) const;
  void store(size_t unit, std::span<const Group> groups) const;
  void count(size_t unit, std::span<const Group> groups, CachedRays& found) const;

  const Scene& scene_;
  const PatchSet& set_;
  const RayCaster& caster_;
  const RayBudget budget_;
  const uint64_t seed_;
  BakeCache& cache_;
  const Contents contents_;
  const LampTree lamps_;
  const LampDigests lamp_digests_;
  const std::vector<uint32_t> start_;  // of units
  Digest settings_{};           // the same for all units: the key of what all of the world held
  std::vector<Digest> keys_;    // by unit
};

}  // namespace ff::bake
