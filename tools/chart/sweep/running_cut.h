// The run time at one observer with one setting: streamer, local matrix and solver, as Updater puts them together, with
// the light of a LitWorld. What is timed here is the product's own code.
#pragma once
#include <memory>
#include <vector>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/solver/converge.h"
#include "runtime/solver/solver.h"
#include "stream/streamer.h"
#include "tools/chart/sweep/measured_world.h"

namespace ff::chart {

struct CutCost {
  std::vector<double> relight;     // samples, in units of the yardstick's time
  double update_ms = 0;            // of all steps of a walk
  double tiles = 0;                // in tiles of 256 level-0 patches that entered on it
  double memory_bytes = 0;         // local matrix, dense matrix, strips in memory
  uint32_t active_nodes = 0, patches = 0, entries = 0;
};

class RunningCut {
 public:
  // world outlives it. Errors: what the run time refuses (a dense matrix too large for the machine, unreadable strips).
  static Result<RunningCut> create(const MeasuredWorld& world, const Knobs& knobs);
  RunningCut(RunningCut&&) noexcept = default;

  // Moves there and waits for all strips.
  Result<void> moveTo(Vec3 observer);
  // Light for the slots; for FarLight::kConstant, the best constant there is: the mean of what is outside.
  Result<void> setLight(const LitWorld& light);
  // Steps of the solver as Updater::converge() takes them (runtime/solver/converge.h).
  Result<runtime::Settled> settle();
  Result<void> step(int k);
  // Irradiance of patches (level-0 node numbers), 3 each: direct light and, through surfaces, the radiosity of the slot by
  // its albedo, of a patch that is not active that of its nearest active ancestor, as the viewer draws it. Of a black slot
  // that is not known: the full solve's.
  Result<std::vector<double>> irradiance(const LitWorld& light, std::span<const uint32_t> patches);
  // Reflected radiosity: the same on the patches' own albedo.
  Result<std::vector<double>> reflected(const LitWorld& light, std::span<const uint32_t> patches);

  // Times `samples` frames whose light has changed, each beside one of the yardstick, so that whatever else the machine does
  // hits both: adds the ratios to cost.relight, the yardstick's own times to yardstick_ms.
  Result<void> timeRelight(int samples, RunningCut& yardstick, CutCost& cost, std::vector<double>& yardstick_ms);
  // Times the changes of the cut while the observer walks on by one patch a step.
  Result<void> timeWalk(Vec3 from, Vec3 direction, int steps, CutCost& cost);
  void measureMemory(CutCost& cost) const;
  // Distance from the observer to the nearest patch that is not active, m.
  float localRadius() const;

 private:
  RunningCut() = default;
  Result<double> timeFrame();  // ms
  const MeasuredWorld* world_ = nullptr;
  Knobs knobs_;
  Vec3 observer_;
  std::unique_ptr<stream::Streamer> streamer_;
  std::unique_ptr<runtime::MatrixAssembler> assembler_;
  std::unique_ptr<runtime::Solver> solver_;
  uint64_t dense_bytes_ = 0;
  std::vector<runtime::Vec4> source_, radiosity_, before_;
};

}  // namespace ff::chart
