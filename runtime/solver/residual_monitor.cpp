#include "runtime/solver/residual_monitor.h"

#include <algorithm>
#include <cmath>

namespace ff::runtime {
namespace {

constexpr uint32_t kRowsAFrame = 256;

}  // namespace

double ResidualMonitor::look(const LocalMatrix& matrix, std::span<const Vec4> source, std::span<const Vec4> radiosity) {
  const auto leaves = static_cast<uint32_t>(matrix.leaves.size());
  float most = 0, largest = 0;
  for (const uint32_t slot : matrix.leaves) {
    const Vec4& b = radiosity[slot];
    largest = std::max({largest, std::abs(b.x), std::abs(b.y), std::abs(b.z)});
  }
  for (uint32_t i = 0; i < std::min(kRowsAFrame, leaves); ++i) {
    const uint32_t slot = matrix.leaves[next_++ % leaves];
    double sum[3] = {0, 0, 0};
    for (const uint32_t entry : matrix.row(slot)) {
      const Vec4& b = radiosity[slotOfEntry(entry)];
      const double count = countOfEntry(entry);
      sum[0] += count * static_cast<double>(b.x);
      sum[1] += count * static_cast<double>(b.y);
      sum[2] += count * static_cast<double>(b.z);
    }
    const Vec4 m = source[slot], rho = matrix.albedo[slot], b = radiosity[slot];
    const auto scale = static_cast<double>(matrix.row_scale[slot]);
    const float should[3] = {m.x + rho.x * static_cast<float>(scale * sum[0]), m.y + rho.y * static_cast<float>(scale * sum[1]),
                             m.z + rho.z * static_cast<float>(scale * sum[2])};
    most = std::max({most, std::abs(should[0] - b.x), std::abs(should[1] - b.y), std::abs(should[2] - b.z)});
  }
  return largest > 0 ? static_cast<double>(most / largest) : 0;
}

}  // namespace ff::runtime
