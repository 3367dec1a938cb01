#include "runtime/updater.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

namespace ff::runtime {
namespace {

using Clock = std::chrono::steady_clock;

double msSince(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

// Radiosity to start from after a change of the cut: a node keeps its own, a new one takes its nearest ancestor's.
std::vector<Vec4> carryOver(const formats::World& world, const LocalMatrix& old, std::span<const Vec4> values,
                            const LocalMatrix& now) {
  std::vector<Vec4> carried(now.slots());
  for (const SlotRange& range : now.tiles) {
    for (uint32_t i = 0; i < range.nodes; ++i) {
      uint32_t node = range.first_node + i, slot = kNoSlot;
      for (uint32_t level = range.id.level; level < world.levels().size() && node != formats::kNoParent; ++level) {
        slot = old.slotOf(level, node);
        if (slot != kNoSlot) break;
        node = world.parent(level, node);
      }
      if (slot != kNoSlot) carried[range.first_slot + i] = values[slot];
    }
  }
  return carried;
}

}  // namespace

Vec3 skyIrradiance(const Sky& sky, const formats::Node& node) {
  if (node.quanta == 0) return {};
  const float open = 3.14159265358979f * static_cast<float>(node.sky) / static_cast<float>(node.quanta);
  return open * Vec3{sky.l0.x + dot(sky.l1[0], node.sky_direction), sky.l0.y + dot(sky.l1[1], node.sky_direction),
                     sky.l0.z + dot(sky.l1[2], node.sky_direction)};
}

Updater::Updater(const formats::World& world, stream::Streamer& streamer, Solver& solver)
    : world_(world), streamer_(streamer), solver_(solver) {}

void Updater::setSky(const Sky& sky) {
  sky_ = sky;
  sky_changed_ = true;
}

void Updater::setDirectLight(DirectLight direct) {
  direct_light_ = std::move(direct);
  light_changed_ = true;
}

void Updater::lightChanged() { light_changed_ = true; }

Result<FrameStats> Updater::frame(Vec3 observer, Vec3 velocity, int iterations) {
  const auto start = Clock::now();
  streamer_.update(observer, velocity);
  // Compared here, not taken from update(): someone may have called settle() in between.
  const auto active = streamer_.active();
  const bool cut_changed = !matrix_ || !std::equal(active.begin(), active.end(), strips_.begin(), strips_.end());
  const double stream_ms = msSince(start);
  const auto matrix_start = Clock::now();
  if (cut_changed)
    if (auto changed = changeMatrix(); !changed) return changed.error();
  if (sky_changed_ || light_changed_)
    if (auto relit = relightAll(); !relit) return relit.error();
  FrameStats stats = counts_;
  stats.matrix_changed = cut_changed;
  stats.stream_ms = stream_ms;
  stats.matrix_ms = msSince(matrix_start);
  if (auto iterated = solver_.iterate(iterations); !iterated) return iterated.error();
  stats.solve_ms = solver_.lastMs();
  return stats;
}

Result<void> Updater::changeMatrix() {
  const auto active = streamer_.active();
  auto built = buildLocalMatrix(world_, active);
  if (!built) return built.error();
  strips_.assign(active.begin(), active.end());
  const auto old = std::exchange(matrix_, std::make_shared<const LocalMatrix>(std::move(*built)));
  std::vector<Vec4> start;
  if (old) {
    radiosity_.resize(old->slots());
    if (auto read = solver_.radiosity(radiosity_); !read) return read.error();
    start = carryOver(world_, *old, radiosity_, *matrix_);
  }
  // Direct light is asked for new tiles only; the others bring theirs along.
  const std::vector<Vec3> old_irradiance = std::exchange(direct_irradiance_, std::vector<Vec3>(matrix_->slots()));
  source_.assign(matrix_->slots(), {});
  direct_.assign(matrix_->slots(), {});
  for (size_t t = 0; t < matrix_->tiles.size(); ++t) {
    const SlotRange& range = matrix_->tiles[t];
    const uint32_t old_slot = old ? old->slotOf(range.id.level, range.first_node) : kNoSlot;
    if (old_slot != kNoSlot)
      std::copy_n(old_irradiance.begin() + old_slot, range.nodes, direct_irradiance_.begin() + range.first_slot);
    light(range, *strips_[t], old_slot == kNoSlot);
  }
  counts_ = {};
  counts_.slots = matrix_->slots();
  counts_.entries = matrix_->entries.size();
  for (const SlotRange& range : matrix_->tiles)
    for (uint32_t slot = range.first_slot; slot < range.first_slot + range.nodes; ++slot) {
      counts_.leaves += matrix_->leaf[slot];
      if (range.id.level == 0) counts_.level0_leaves += matrix_->leaf[slot];
    }
  if (auto set = solver_.setMatrix(matrix_, start); !set) return set.error();
  return solver_.setSource(source_);
}

void Updater::light(const SlotRange& range, const formats::Strip& strip, bool ask_direct_light) {
  const std::span<Vec3> irradiance = std::span(direct_irradiance_).subspan(range.first_slot, range.nodes);
  if (ask_direct_light) {
    std::fill(irradiance.begin(), irradiance.end(), Vec3{});
    if (direct_light_) direct_light_(range.id, irradiance);
  }
  for (uint32_t i = 0; i < range.nodes; ++i) {
    const formats::Node& node = strip.nodes[i];
    const Vec3 direct = node.emission + node.albedo * irradiance[i];
    const Vec3 all = direct + node.albedo * skyIrradiance(sky_, node);
    direct_[range.first_slot + i] = {direct.x, direct.y, direct.z, 0};
    source_[range.first_slot + i] = {all.x, all.y, all.z, 0};
  }
}

Result<void> Updater::relightAll() {
  for (size_t t = 0; t < matrix_->tiles.size(); ++t) light(matrix_->tiles[t], *strips_[t], light_changed_);
  sky_changed_ = light_changed_ = false;
  return solver_.setSource(source_);
}

Result<int> Updater::converge(float tolerance, int max_iterations) {
  FF_CHECK_EQ(matrix_ != nullptr, true);
  constexpr int kBatch = 8;  // iterations between two looks at the change
  radiosity_.resize(matrix_->slots());
  before_.resize(matrix_->slots());
  for (int done = 0; done < max_iterations;) {
    const int batch = std::min(kBatch, max_iterations - done);
    if (auto r = solver_.iterate(batch - 1); !r) return r.error();
    if (auto r = solver_.radiosity(before_); !r) return r.error();
    if (auto r = solver_.iterate(1); !r) return r.error();
    if (auto r = solver_.radiosity(radiosity_); !r) return r.error();
    done += batch;
    float change = 0, largest = 0;
    for (size_t s = 0; s < radiosity_.size(); ++s) {
      const Vec4 a = before_[s], b = radiosity_[s];
      change = std::max({change, std::abs(b.x - a.x), std::abs(b.y - a.y), std::abs(b.z - a.z)});
      largest = std::max({largest, std::abs(b.x), std::abs(b.y), std::abs(b.z)});
    }
    if (change <= tolerance * largest) return done;
  }
  return max_iterations;
}

const LocalMatrix& Updater::matrix() const {
  FF_CHECK_EQ(matrix_ != nullptr, true);
  return *matrix_;
}
std::span<const Vec4> Updater::source() const { return source_; }
std::span<const Vec4> Updater::direct() const { return direct_; }
Result<void> Updater::radiosity(std::span<Vec4> out) { return solver_.radiosity(out); }

}  // namespace ff::runtime
