#include "runtime/solver/converge.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace ff::runtime {

Result<Settled> converge(Solver& solver, const Convergence& until, std::span<Vec4> radiosity, std::span<Vec4> before) {
  constexpr int kMaxBatch = 64;  // iterations between two looks at the change: long runs are the quicker ones
  Settled out;
  while (!out.settled && out.iterations < until.max_iterations) {
    const int batch =
        std::min({std::max(until.fewest, out.iterations), kMaxBatch, until.max_iterations - out.iterations});
    if (auto r = solver.approach(batch - 1); !r) return r.error();
    if (auto r = solver.radiosity(before); !r) return r.error();
    if (auto r = solver.iterate(1); !r) return r.error();
    if (auto r = solver.radiosity(radiosity); !r) return r.error();
    out.iterations += batch;
    float change = 0, largest = 0;
    bool finite = true;
    for (size_t s = 0; s < radiosity.size(); ++s) {
      const Vec4 a = before[s], b = radiosity[s];
      change = std::max({change, std::abs(b.x - a.x), std::abs(b.y - a.y), std::abs(b.z - a.z)});
      largest = std::max({largest, std::abs(b.x), std::abs(b.y), std::abs(b.z)});
      finite = finite && std::isfinite(b.x + b.y + b.z);
    }
    if (!finite) {
      out.change = std::numeric_limits<double>::infinity();
      return out;
    }
    out.change = largest > 0 ? static_cast<double>(change / largest) : 0;
    out.settled = out.change <= static_cast<double>(until.tolerance);
  }
  return out;
}

}  // namespace ff::runtime
