// A solver's steps until its light has settled.
#pragma once
#include <span>

#include "runtime/solver/solver.h"

namespace ff::runtime {

struct Convergence {
  float tolerance = 1e-5f;    // of the largest radiosity
  int max_iterations = 4000;
  int fewest = 8;             // steps before the first look; a solver whose step takes in all bounces needs no more than 2
};

struct Settled {
  int iterations = 0;
  // What is undone: the largest change of any channel by the last step, a Jacobi step of `gather`, over the largest
  // radiosity. Of `gather` it is the residual of the light before that step.
  double change = 0;
  bool settled = false;  // the change is below the tolerance
};

// Lets the solver approach() its solution until one step more changes no channel by more than the tolerance, or
// max_iterations are done, or the light is not finite (change: infinity). radiosity, before: one value a slot; the
// former is the last step's, the latter that of the step before.
Result<Settled> converge(Solver& solver, const Convergence& until, std::span<Vec4> radiosity, std::span<Vec4> before);

}  // namespace ff::runtime
