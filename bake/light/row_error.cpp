#include "bake/light/row_error.h"

#include <algorithm>

#include "bake/rays/sobol.h"

namespace ff::bake {
namespace {

constexpr int kLitLog = 2;  // cells of a cube that is lit as one, log2

}  // namespace

MadeUpLight::MadeUpLight(const PatchSet& set) {
  lit_.reserve(set.patches.size());
  for (const Patch& p : set.patches) lit_.push_back(static_cast<uint8_t>(mix64(hilbertAncestor(p.key, kLitLog) * kOrientations + p.orientation + 1)));
}

double RowError::square(uint32_t rays) const {
  std::array<double, 2> scale{};  // rows are made to add up, too
  for (size_t half = 0; half < 2; ++half) scale[half] = stand_for_[half] > 0 ? rays_[half] / stand_for_[half] : 0;
  double off = 0, all = 0;
  for (size_t l = 0; l < MadeUpLight::kLights; ++l) {
    const double a = lit_[0][l] * scale[0], b = lit_[1][l] * scale[1];
    off += (a - b) * (a - b);
    all += a + b + sky_;
  }
  const double brought = std::max(all / MadeUpLight::kLights, kFloor * rays);
  return kPooled * off / MadeUpLight::kLights / (brought * brought);
}

}  // namespace ff::bake
