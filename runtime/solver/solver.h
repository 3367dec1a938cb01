// B = M + albedo * F B over the slots of a local matrix; one interface for the CPU and Vulkan.
// B is the radiosity that slots reflect, M what they reflect of light that arrives without a bounce among slots: albedo *
// (direct + sky + lamps' irradiance). What they emit is no solver's: lamps light slots past the rows (runtime/lamps.h).
#pragma once
#include <memory>
#include <span>

#include "formats/result.h"
#include "runtime/cut/local_matrix.h"
#include "runtime/solver/light_pace.h"

namespace ff::runtime {

// What has crossed the bus to a solver's device since the start, bytes; none on the CPU.
struct UploadedBytes {
  uint64_t rows = 0;   // of the matrix: packed rows, pages, lists of what to do with them; blocks of dense matrices, and what watches these
  uint64_t light = 0;  // by slot: sources, radiosity to go on from, emission, and which tiles fade
};

class Solver {
 public:
  virtual ~Solver() = default;
  // Takes up a change of the matrix, which is the caller's, stays where it is and outlives the solver; called after
  // each change of it. (The first call takes up the whole matrix.) Slots that stay keep their radiosity, nodes of tiles
  // that entered start from their parents' (those without one in the cut from zero); after change.renumbered all starts from zero.
  virtual Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) = 0;
  // Whether it resolves rows itself, on a device: update() is quicker then where MatrixChange::packed is written. (One that stands for another says what that one does.)
  virtual bool resolvesRows() const = 0;
  // M per slot, W/m2. What is no sound light (sound_light.h) counts as 0. Refined and free slots' values are ignored.
  virtual Result<void> setSource(std::span<const Vec4> source) = 0;
  // The same after an update() that the solver has taken up, where only nodes that entered by it have other values than were given before. stays: they are as they are until the next
  // iterate(), which may read them.
  virtual Result<void> setEnteredSource(std::span<const Vec4> source, const MatrixChange&, bool /*stays*/) { return setSource(source); }
  // Radiosity to go on from, per slot; likewise.
  virtual Result<void> setRadiosity(std::span<const Vec4> radiosity) = 0;
  // From now on light takes so many calls of iterate() to follow a change of the cut. What changed rows, and rows of nodes that enter, would do to a slot at
  // once is held back: it stands beside the slot's source, and goes evenly. Nodes that enter begin with their parents' irradiance. A change of sources is
  // never held back. 0: what is held back goes now. The baselines do nothing.
  virtual void ease(uint32_t) {}
  // By the next iterate(), and those after it, no slot's light follows by more than this, though it takes longer.
  virtual void pace(const LightPace&) {}
  // k steps, after which refined slots are the mean of their children. What a step is, is the solver's: `gather` makes
  // one Jacobi iteration B <- M + albedo * F B, a dense one takes in all bounces at once.
  virtual Result<void> iterate(int k) = 0;
  // k steps towards the solution under a light that stays, by the quickest way that the solver knows; what lies between
  // is no picture. By default iterate(k).
  virtual Result<void> approach(int k) { return iterate(k); }
  // Copies the radiosity of every slot, W/m2; 0 for free slots once a step has been made.
  virtual Result<void> radiosity(std::span<Vec4> out) = 0;
  // The same where it lies, until the next call but for readings; empty: not in this process's memory.
  virtual std::span<const Vec4> inMemory() { return {}; }
  // Values that were no sound light, since the start: of sources and radiosities given, taken for 0; of a step's
  // results, where the slot has gone on from its source. No step leaves any. Recorded steps count when they have run.
  virtual uint64_t repaired() const { return 0; }
  virtual UploadedBytes uploaded() const { return {}; }
  // Time of the last iterate(), ms, on the clock of the device that ran it.
  virtual double lastMs() const = 0;
  virtual const char* name() const = 0;  // "cpu", "vulkan: llvmpipe ..."
};

// threads: 0 = all cores.
std::unique_ptr<Solver> makeCpuGather(int threads = 0);

}  // namespace ff::runtime
