#include "runtime/converge.h"

#include <algorithm>
#include <cmath>

namespace ff::runtime {

Result<int> converge(Solver& solver, const Convergence& until, std::span<Vec4> radiosity, std::span<Vec4> before) {
  constexpr int kMost = 64;  // iterations between two looks at the change: long runs are the quicker ones
  for (int done = 0; done < until.max_iterations;) {
    const int batch = std::min({std::max(until.fewest, done), kMost, until.max_iterations - done});
    if (auto r = solver.approach(batch - 1); !r) return r.error();
    if (auto r = solver.radiosity(before); !r) return r.error();
    if (auto r = solver.iterate(1); !r) return r.error();
    if (auto r = solver.radiosity(radiosity); !r) return r.error();
    done += batch;
    float change = 0, largest = 0;
    for (size_t s = 0; s < radiosity.size(); ++s) {
      const Vec4 a = before[s], b = radiosity[s];
      change = std::max({change, std::abs(b.x - a.x), std::abs(b.y - a.y), std::abs(b.z - a.z)});
      largest = std::max({largest, std::abs(b.x), std::abs(b.y), std::abs(b.z)});
    }
    if (!(change > until.tolerance * largest)) return done;
  }
  return until.max_iterations;
}

}  // namespace ff::runtime
