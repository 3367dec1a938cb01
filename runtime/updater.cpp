#include "runtime/updater.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "runtime/converge.h"

namespace ff::runtime {
namespace {

using Clock = std::chrono::steady_clock;

double msSince(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

// Radiosity to go on from after slots were given out anew: a node keeps its own, a new one takes its nearest
// ancestor's.
void carryOver(const formats::World& world, std::span<const SlotRange> old, std::span<const Vec4> values,
               const LocalMatrix& now, std::span<Vec4> carried) {
  for (const SlotRange& range : now.tiles) {
    for (uint32_t i = 0; i < range.nodes; ++i) {
      uint32_t node = range.first_node + i, slot = kNoSlot;
      for (uint32_t level = range.id.level; level < world.levels().size() && node != formats::kNoParent; ++level) {
        slot = slotOf(old, level, node);
        if (slot != kNoSlot) break;
        node = world.parent(level, node);
      }
      carried[range.first_slot + i] = slot != kNoSlot ? values[slot] : Vec4{};
    }
  }
}

}  // namespace

Vec3 skyIrradiance(const Sky& sky, const formats::Node& node) {
  if (node.quanta == 0) return {};
  const float open = 3.14159265358979f * static_cast<float>(node.sky) / static_cast<float>(node.quanta);
  return open * Vec3{sky.l0.x + dot(sky.l1[0], node.sky_direction), sky.l0.y + dot(sky.l1[1], node.sky_direction),
                     sky.l0.z + dot(sky.l1[2], node.sky_direction)};
}

Updater::Updater(const formats::World& world, stream::Streamer& streamer, Solver& solver, FarLight far_light)
    : world_(world), streamer_(streamer), solver_(solver), assembler_(world, far_light) {
  for (auto* per_slot : {&source_, &direct_, &radiosity_, &before_}) per_slot->reserve(kMaxSlots);
  direct_irradiance_.reserve(kMaxSlots);
  tiles_before_.reserve(kMaxSlots / 16);
}

void Updater::setSky(const Sky& sky) {
  sky_ = sky;
  sky_changed_ = true;
}

void Updater::setAmbient(Vec3 radiosity) {
  ambient_ = radiosity;
  sky_changed_ = true;
}

void Updater::setDirectLight(DirectLight direct) {
  direct_light_ = std::move(direct);
  light_changed_ = true;
}

void Updater::lightChanged() { light_changed_ = true; }

void Updater::setDirectIrradiance(uint32_t first_slot, std::span<const Vec3> irradiance) {
  for (size_t i = 0; i < irradiance.size() && first_slot + i < direct_irradiance_.size(); ++i)
    direct_irradiance_[first_slot + i] = irradiance[i];
  sky_changed_ = true;  // all sources are made anew, from what is here
}

Result<FrameStats> Updater::frame(Vec3 observer, Vec3 velocity, int iterations) {
  const auto start = Clock::now();
  streamer_.update(observer, velocity);
  const double stream_ms = msSince(start);
  const auto matrix_start = Clock::now();
  const auto& tiles = assembler_.matrix().tiles;
  tiles_before_.assign(tiles.begin(), tiles.end());
  if (auto updated = assembler_.update(streamer_.active()); !updated) return updated.error();
  const bool changed = assembler_.change().any;
  if (changed)
    if (auto taken = takeUpChange(); !taken) return taken.error();
  if (sky_changed_ || light_changed_)
    if (auto relit = relightAll(); !relit) return relit.error();
  FrameStats stats = counts_;
  stats.matrix_changed = changed;
  stats.stream_ms = stream_ms;
  stats.matrix_ms = msSince(matrix_start);
  if (auto iterated = solver_.iterate(iterations); !iterated) return iterated.error();
  stats.solve_ms = solver_.lastMs();
  return stats;
}

Result<void> Updater::takeUpChange() {
  const LocalMatrix& m = matrix();
  const MatrixChange& change = assembler_.change();
  const bool carry = started_ && change.renumbered;
  if (carry) {  // radiosity_ has the size of the matrix before
    if (auto read = solver_.radiosity(radiosity_); !read) return read.error();
    before_.assign(m.slots(), {});
    carryOver(world_, tiles_before_, radiosity_, m, before_);
  }
  started_ = true;
  for (auto* per_slot : {&source_, &direct_, &radiosity_}) per_slot->resize(m.slots());
  direct_irradiance_.resize(m.slots());
  // Direct light is asked for new tiles only; the others keep theirs.
  for (const uint32_t tile : change.entered) light(tile, true);
  if (m.ambient_slot != kNoSlot) source_[m.ambient_slot] = {ambient_.x, ambient_.y, ambient_.z, 0};
  counts_ = {};
  counts_.slots = m.slots();
  counts_.leaves = static_cast<uint32_t>(m.leaves.size());
  counts_.entries = m.used_entries;
  for (const SlotRange& range : m.tiles)
    if (range.id.level == 0) counts_.level0_leaves += range.nodes;
  if (auto updated = solver_.update(m, change); !updated) return updated.error();
  if (carry)
    if (auto set = solver_.setRadiosity(before_); !set) return set.error();
  return solver_.setSource(source_);
}

void Updater::light(uint32_t tile, bool ask_direct_light) {
  const SlotRange& range = matrix().tiles[tile];
  const stream::ResidentStrip& strip = assembler_.strip(tile);
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
  const LocalMatrix& m = matrix();
  for (uint32_t t = 0; t < m.tiles.size(); ++t) light(t, light_changed_);
  if (m.ambient_slot != kNoSlot) source_[m.ambient_slot] = {ambient_.x, ambient_.y, ambient_.z, 0};
  sky_changed_ = light_changed_ = false;
  return solver_.setSource(source_);
}

Result<int> Updater::converge(float tolerance, int max_iterations) {
  FF_CHECK_EQ(started_, true);
  before_.resize(matrix().slots());
  return runtime::converge(solver_, {.tolerance = tolerance, .max_iterations = max_iterations}, radiosity_, before_);
}

const LocalMatrix& Updater::matrix() const { return assembler_.matrix(); }
std::span<const Vec4> Updater::source() const { return source_; }
std::span<const Vec4> Updater::direct() const { return direct_; }
Result<void> Updater::radiosity(std::span<Vec4> out) { return solver_.radiosity(out); }

}  // namespace ff::runtime
