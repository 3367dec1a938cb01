// A solver that outlives its device: when the first one loses its device or runs out of device memory, the second (on
// the CPU) takes over with the same matrix, the same light and the radiosity last seen, within the same call. The first one stays, unused, until
// the end: a caller's command buffers may still use what it holds, and nothing waits for them.
#pragma once
#include <memory>
#include <string>

#include "runtime/solver/solver.h"

namespace ff::runtime {

class FallbackSolver : public Solver {
 public:
  // The error that made the second solver take over; empty: the first one is still in use.
  virtual const std::string& reason() const = 0;
};

// Other errors of the first solver are handed on. name() is that of the solver in use.
std::unique_ptr<FallbackSolver> makeFallbackSolver(std::unique_ptr<Solver> first, std::unique_ptr<Solver> second);

}  // namespace ff::runtime
