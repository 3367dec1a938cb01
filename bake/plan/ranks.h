// Other processes that cast units of rays for one bake, on this machine or others. They read the same scene and keep hits in the same bake cache; what goes
// between them is the numbers of units alone. A process that is gone costs the units that it was casting: they are cast again.
#pragma once
#include <cstdint>
#include <functional>
#include <limits>

namespace ff::bake {

inline constexpr uint32_t kNoUnit = std::numeric_limits<uint32_t>::max();

class Ranks {
 public:
  virtual ~Ranks() = default;
  virtual int rank() const = 0;  // 0: the one that bakes; the others help
  virtual int size() const = 0;

  // Rank 0: answers the others from a thread of its own until it is destroyed. next: the next unit, or kNoUnit for ever once there is none; done: a unit is in the
  // cache. Neither is called any more after endUnits(), which answers all by kNoUnit.
  virtual void serve(std::function<uint32_t()> next, std::function<void(uint32_t unit)> done) = 0;
  virtual void endUnits() = 0;

  // The others: says that `done` is in the cache (kNoUnit: nothing is), and returns the next one; kNoUnit: there is no more, or rank 0 is gone. Thread-safe.
  virtual uint32_t ask(uint32_t done) = 0;
};

}  // namespace ff::bake
