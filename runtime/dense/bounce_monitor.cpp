#include "runtime/dense/bounce_monitor.h"

#include <algorithm>
#include <cmath>

namespace ff::runtime {
namespace {

constexpr uint32_t kFrames = 16, kRowPhases = 8;

}  // namespace

double defaultProbeLimit(const std::string& matrix_name) {
  if (matrix_name.find("luminance") != std::string::npos) return 5e-2;
  return matrix_name.find("fp16") != std::string::npos ? 2e-2 : 1e-4;
}

BounceMonitor::BounceMonitor(uint32_t capacity, double limit) : limit_(limit) {
  for (auto* list : {&drawn_, &sampled_}) list->reserve(capacity);
  x_.reserve(capacity);
  for (auto* per_slot : {&work_, &minus_, &residual_}) per_slot->reserve(kMaxSlots);
}

void BounceMonitor::draw(const CutPlaces& places) {
  const auto random = [this] {
    random_ = random_ * 6364136223846793005u + 1442695040888963407u;
    return static_cast<float>(random_ >> 40) / 16777216.0f;
  };
  drawn_.clear();
  sampled_.clear();
  x_.clear();
  const uint32_t row_phase = static_cast<uint32_t>(random_ >> 33) % kRowPhases;
  const std::span<const uint32_t> slots = places.slots();
  for (uint32_t p = 0, n = 0; p < slots.size(); ++p) {
    if (slots[p] == kNoSlot) continue;
    if (n % kFrames == frame_) {
      drawn_.push_back(p);
      x_.push_back({random(), random(), random(), 0});
    }
    if (n++ / kFrames % kRowPhases == row_phase) sampled_.push_back(slots[p]);
  }
}

void BounceMonitor::judge(const LocalMatrix& matrix, const CutPlaces& places, SparseRows& rows, std::span<const Vec4> y) {
  verdict_.clear();
  for (auto* per_slot : {&work_, &minus_, &residual_}) per_slot->assign(matrix.slots(), {});
  // F x, then F (x + C y) - y.
  for (size_t i = 0; i < drawn_.size(); ++i) work_[places.slotOf(drawn_[i])] = x_[i];
  rows.refine(work_);
  rows.gather(sampled_, work_, minus_, residual_);
  for (const uint32_t s : sampled_) {
    norm_ += squared(residual_[s]);
    const Vec4& e = y[places.placeOf(s)];
    minus_[s] = {-e.x, -e.y, -e.z, 0};
  }
  const std::span<const uint32_t> slots = places.slots();
  for (uint32_t p = 0; p < slots.size(); ++p) {
    if (slots[p] == kNoSlot) continue;
    const Vec4 &rho = matrix.albedo[slots[p]], &e = y[p];
    Vec4& w = work_[slots[p]];
    w = {w.x + rho.x * e.x, w.y + rho.y * e.y, w.z + rho.z * e.z, 0};
  }
  rows.refine(work_);
  rows.gather(sampled_, work_, minus_, residual_);
  for (const uint32_t s : sampled_) left_ += squared(residual_[s]);
  if (++frame_ < kFrames) return;
  round_ = norm_ > 0 ? std::sqrt(left_ / norm_) : 0;
  frame_ = 0;
  left_ = norm_ = 0;
  if (untouched_ && std::isfinite(round_) && (fresh_ < 0 || round_ < fresh_)) fresh_ = round_;
  const double limit = std::max(limit_, kOfFresh * fresh_);
  if (!(round_ <= limit))
    verdict_ = "residual probe " + std::to_string(round_) + " above its limit of " + std::to_string(limit);
}

void BounceMonitor::builtAnew() {
  frame_ = 0;
  left_ = norm_ = 0;
  fresh_ = -1;
  untouched_ = true;
}

}  // namespace ff::runtime
