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
  double off = 0, all = 0;
  for (size_t l = 0; l < MadeUpLight::kLights; ++l) {
    const auto a = static_cast<double>(lit_[0][l]), b = static_cast<double>(lit_[1][l]);
    off += (a - b) * (a - b);
    all += a + b + sky_;
  }
  const double brought = std::max(all / MadeUpLight::kLights, kFloor * rays);
  return off / MadeUpLight::kLights / (brought * brought);
}

}  // namespace ff::bake
