// A Solver on a dense matrix of all bounces (bounce_matrix.h), on the CPU or Vulkan.
//
// Leaves of the local matrix sit on places of the dense one, the finest levels first; where there are more leaves than
// places the rest is left to the sparse rows. A step corrects the irradiance E by what the sparse rows say is missing:
//   r = F (M + C E) - E,   E <- E + r + G C r.
// With all leaves on places and G exact, this is E = G M in one step, from any E. Errors of G (fp16, drift) shrink E's
// own error instead of being it. With only some leaves P on places, I + G C is (I - F_PP C)^-1: a regular splitting of
// I - F C (Varga, R. "Matrix Iterative Analysis." 1962), which converges from any E and never slower than `gather`.
// So nothing is ever wrong while nodes wait to enter or the matrix is built anew, only less is done in one step.
#pragma once
#include <memory>
#include <string>

#include "runtime/dense/bounce_matrix.h"
#include "runtime/solver/solver.h"

namespace ff::runtime {

struct DenseSettings {
  // false: E = G M and nothing else, for the baselines. All leaves must fit, and there is no probe.
  bool correct = true;
  // Blocks of up to kMaxBlock nodes that enter in a frame (iterate()); 0: all at once, in update().
  uint32_t blocks_per_frame = 0;
  // Columns of a time-sliced matrix brought up to date in a frame.
  uint32_t columns_per_frame = 512;
  // The residual probe (bounce_monitor.h), a sixteenth of a round each frame. Cost of it: a sixteenth of a dense product and
  // a quarter of a sparse one. Above the limit the matrix is built anew, kRebuildBlocks a frame. 0: defaultProbeLimit().
  double probe_limit = 0;
  int threads = 0;  // for the sparse rows; 0 = all cores
};

inline constexpr uint32_t kRebuildBlocks = 4;

// With the light and the nodes as they were, a correction that leaves more than it found is none: why the matrix should be
// built anew, from the residuals before two corrections (below 0: not to be compared with). Empty: it need not.
std::string whyGrown(double before, double now);

struct DenseStats {
  uint64_t entered = 0, left = 0;  // nodes, over all changes of the cut
  uint32_t on_places = 0;
  uint32_t waiting = 0;      // leaves that wait for a place or their turn
  uint64_t refused = 0;      // blocks that the matrix refused: their nodes are left to the sparse rows
  uint64_t rebuilds = 0;     // by the probe, because errors grew, or because something was not finite
  double probe = 0;          // the last complete round's ratio
  double residual = 0;       // ||r|| / ||F M|| before the last correction
  std::string last_event{};  // why the last rebuild or refusal was; empty: none yet
};

class DenseSolver : public Solver {
 public:
  virtual const DenseStats& stats() const = 0;
  virtual const BounceMatrix& matrix() const = 0;
};

// An error of update() that is no refusal (a lost device, say) is passed on; the solver is then as before the call, but
// for its matrix.
std::unique_ptr<DenseSolver> makeDenseSolver(std::unique_ptr<BounceMatrix> matrix, const DenseSettings& settings = {});

}  // namespace ff::runtime
