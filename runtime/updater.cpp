#include "runtime/updater.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "runtime/clock.h"
#include "runtime/solver/sound_light.h"

namespace ff::runtime {
namespace {

// What is reflected, to go on from after slots were given out anew: a node keeps its own, a new one takes its nearest
// ancestor's.
void carryOver(std::span<const SlotRange> old, std::span<const Vec4> values, const LocalMatrix& now, std::span<Vec4> carried) {
  auto before = old.begin();
  for (size_t t = 0; t < now.tiles.size(); ++t) {
    const SlotRange& range = now.tiles[t];
    while (before != old.end() && before->id < range.id) ++before;
    if (before != old.end() && before->id == range.id) {
      std::copy_n(values.begin() + before->first_slot, range.nodes, carried.begin() + range.first_slot);
      continue;
    }
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const uint32_t slot = slotFor(old, now.packed[t].strip->tile, i);
      carried[range.first_slot + i] = slot != kNoSlot ? values[slot] : Vec4{};
    }
  }
}

constexpr float kJumpCells = 8;        // farther than an observer goes in a frame
constexpr float kLongestFrame = 0.1f;  // s
constexpr float kPause = 2;            // times as long as frames of late, no frame counts for more: somebody waits for something else
constexpr float kTurns = 1;            // a streamer in the background looks at a place in one frame, and what it has found is taken up in the next
constexpr float kSlack = 4;            // frames that threads may lose while others have their cores
constexpr int kSteps = 2;              // a frame, of which one does where light rests: of what a new cut changes, all but what is due is held back
constexpr uint32_t kRestFrames = 60;   // it rests once it has been the same for so long
constexpr uint32_t kArriveFrames = 20; // who has jumped has what was not there by then
constexpr float kBuilds = 2;           // a tile may have to wait for the matrix that is being put together, and then for its own

Error noLight(std::string place, const char* why) {
  return {ErrorCode::kUsage, "", std::move(place), why, "give a finite number from 0 to 1e12 W/m2"};
}

}  // namespace

Vec3 originStep(const formats::WorldInfo& from, const formats::WorldInfo& to) {
  Vec3 step;
  for (int a = 0; a < 3; ++a) step[a] = static_cast<float>(from.origin[static_cast<size_t>(a)] - to.origin[static_cast<size_t>(a)]);
  return step;
}

Updater::Updater(const formats::World& world, stream::Streamer& streamer, Solver& solver, FarLight far_light, bool background, const FadeSettings& fade, uint32_t max_applied_tiles,
                 stream::Now now)
    : world_(world), streamer_(streamer), solver_(solver), now_(std::move(now)), lamps_(world.info()), fade_(fade, streamer.radii()), cut_(world, far_light, background, &entering_, solver.resolvesRows(), now_, {slotsFor(streamer.maxNodes()), fade.max_nodes, max_applied_tiles}) {
  const uint32_t most = matrix().most_slots;
  const auto take = [most](auto& per_slot) {
    per_slot.reserve(kMaxSlots);
    touchMemory(per_slot, most);
  };
  for (auto* per_slot : {&source_, &emission_, &radiosity_, &before_}) take(*per_slot);
  for (auto* per_slot : {&direct_irradiance_, &lamp_irradiance_}) take(*per_slot);
  take(emits_);
  tiles_before_.reserve(kMaxSlots / 16);
  entering_.set(sky_, lamps_);
}

Result<void> Updater::setSky(const Sky& sky) {
  if (const char* why = whyNoLight(sky.l0)) return noLight("sky, radiance", why);
  for (const Vec3& gradient : sky.l1)
    for (int a = 0; a < 3; ++a)  // which has either sign
      if (const char* why = whyNoLight(std::abs(gradient[a]))) return noLight("sky, gradient", why);
  for (const auto& quadratic : sky.l2)
    for (const float q : quadratic)
      if (const char* why = whyNoLight(std::abs(q))) return noLight("sky, quadratic", why);
  sky_ = sky;
  sky_changed_ = true;
  entering_.set(sky_, lamps_);
  return {};
}

Result<void> Updater::setLamp(uint32_t group, Vec3 scale) {
  FF_CHECK_LT(group, lamps_.groups());
  if (const char* why = whyNoLight(world_.info().lamp_groups[group].emission * scale)) return noLight("lamp group " + std::to_string(group), why);
  scale = max(scale, {});
  if (lamps_.scale(group) == scale) return {};
  lamps_.set(group, scale);
  lamps_changed_ = true;
  return {};
}

Result<void> Updater::setAmbient(Vec3 radiosity) {
  if (const char* why = whyNoLight(radiosity)) return noLight("ambient", why);
  ambient_ = max(radiosity, {});
  sky_changed_ = true;
  return {};
}

void Updater::setDirectLight(DirectLight direct) {
  direct_light_ = std::move(direct);
  light_changed_ = has_direct_ = true;
}

void Updater::lightChanged() { light_changed_ = true; }

Result<void> Updater::setDirectIrradiance(uint32_t first_slot, std::span<const Vec3> irradiance) {
  const size_t slots = direct_irradiance_.size();
  irradiance = irradiance.first(first_slot < slots ? std::min(irradiance.size(), slots - first_slot) : 0);
  for (uint32_t i = 0; i < irradiance.size(); ++i)
    if (const char* why = whyNoLight(irradiance[i])) return noLight(nameOf(first_slot + i), why);
  for (size_t i = 0; i < irradiance.size(); ++i) direct_irradiance_[first_slot + i] = max(irradiance[i], {});
  sky_changed_ = has_direct_ = true;  // all sources are made anew, from what is here
  return {};
}

// "direct irradiance of slot 17: tile 0:3, node 12".
std::string Updater::nameOf(uint32_t slot) const {
  std::string name = "direct irradiance of slot " + std::to_string(slot);
  for (const SlotRange& range : matrix().tiles)
    if (slot - range.first_slot < range.nodes)
      return name + ": tile " + std::to_string(range.id.level) + ":" + std::to_string(range.id.tile) + ", node " +
             std::to_string(range.first_node + slot - range.first_slot);
  return name + ": a slot of no tile";
}

Result<FrameStats> Updater::frame(const stream::Observers& observers, int iterations) {
  const auto start = Clock::now();
  light_zeroed_ = applied_tiles_ = 0;
  // What a frame takes, over a few of them; a pause is none.
  const Clock::time_point begins = now_();
  const float seconds = frame_began_ == Clock::time_point{} ? 0 : std::min(std::chrono::duration<float>(begins - frame_began_).count(), kLongestFrame);
  frame_began_ = begins;
  frame_seconds_ += frame_seconds_ == 0 ? seconds : (std::min(seconds, kPause * frame_seconds_) - frame_seconds_) / 8;
  const float until_built = cut_.latencySeconds() + kTurns * frame_seconds_;
  const float until_active = kBuilds * cut_.latencySeconds() + (kTurns + kSlack) * frame_seconds_;
  lead_ = {until_built, until_active, until_active + fade_.begin(observers, frame_seconds_)};
  streamer_.setLead(lead_);
  streamer_.update(observers);
  jumped_ |= observers.movedBy(kJumpCells * world_.info().cell_m, std::exchange(observers_, observers));
  const double stream_ms = msSince(start);
  const auto matrix_start = Clock::now();
  if (lamps_changed_) entering_.set(sky_, lamps_);
  const auto changed = followCut();
  if (!changed) return changed.error();
  const bool lights = relit();
  if (lights)
    if (auto lit = relightAll(); !lit) return lit.error();
  rested_frames_ = lights ? 0 : rested_frames_ + 1;
  FrameStats stats = counts_;
  stats.matrix_changed = *changed;
  stats.light_zeroed = light_zeroed_;
  stats.applied_tiles = applied_tiles_;
  stats.waiting_tiles = cut_.waiting();
  stats.stream_ms = stream_ms;
  stats.matrix_ms = msSince(matrix_start);
  fade_.advance(observers);
  LightPace pace = fade_.pace(observers, frame_seconds_);
  if (frames_since_jump_ < kArriveFrames) pace.most_change = 0;  // who has jumped sees nothing that he has seen before
  solver_.pace(pace);
  const auto steps_start = Clock::now();
  const auto iterated = solver_.iterate(iterations != kAsLightNeeds ? iterations : rested_frames_ < kRestFrames ? kSteps : 1);
  stats.steps_ms = msSince(steps_start);
  cut_.begin();
  if (!iterated) return iterated.error();
  stats.solve_ms = solver_.lastMs();
  stats.uploaded = solver_.uploaded();
  return stats;
}

Result<void> Updater::prepare(const formats::WorldInfo& before) {
  if (auto asked = cut_.ask({.active = streamer_.activeList(), .whole = true}); !asked) return asked.error();
  cut_.await();
  if (auto taken = cut_.take(); !taken) return taken.error();
  const LocalMatrix& m = matrix();
  tiles_before_.assign(m.tiles.begin(), m.tiles.end());
  for (auto* tiles : {&whole_.entered, &whole_.rows}) tiles->reserve(m.tiles.size());
  // The pages of these are the system's to find now, not within a frame.
  for (auto* per_slot : {&source_, &emission_, &radiosity_, &before_}) per_slot->assign(m.slots(), {});
  for (auto* per_slot : {&direct_irradiance_, &lamp_irradiance_}) per_slot->assign(m.slots(), {});
  emits_.assign(m.slots(), 0);
  names_.clear();
  for (uint32_t t = 0; t < m.tiles.size(); ++t) names_.push_back({m.tiles[t].id.level, m.places[t].name, t});
  std::ranges::sort(names_, {}, &Named::key);
  lamp_before_.clear();
  for (const formats::LampGroup& group : world_.info().lamp_groups) {
    const auto at = std::ranges::find(before.lamp_groups, group.name, &formats::LampGroup::name);
    lamp_before_.push_back(at == before.lamp_groups.end() ? formats::kNoLampGroup : static_cast<uint32_t>(at - before.lamp_groups.begin()));
  }
  from_before_ = originStep(before, world_.info());
  return {};
}

void Updater::goOnFrom(Updater& before) {
  sky_ = before.sky_;
  ambient_ = before.ambient_;
  direct_light_ = std::move(before.direct_light_);
  has_direct_ = before.has_direct_;
  for (uint32_t group = 0; group < lamp_before_.size(); ++group)
    if (lamp_before_[group] != formats::kNoLampGroup) lamps_.set(group, before.lamps_.scale(lamp_before_[group]));
  sky_changed_ = light_changed_ = lamps_changed_ = true;
  emission_change_ = before.emission_change_;
  frame_began_ = before.frame_began_;
  frame_seconds_ = before.frame_seconds_;
  takeLight(before);
  started_ = missed_ = true;
}

// Into before_, by slot.
void Updater::takeLight(Updater& before) {
  const LocalMatrix &from = before.matrix(), &m = matrix();
  std::vector<Vec4>& old = before.radiosity_;
  if (before.isTakenUp()) {
    if (!solver_.radiosity(old)) std::ranges::fill(old, Vec4{});
  } else {
    old.assign(before.before_.begin(), before.before_.end());
  }
  constexpr Vec4 kUnknown{-1, 0, 0, 0};  // which no light is
  before_.assign(m.slots(), kUnknown);
  if (old.size() != from.slots()) return before_.assign(m.slots(), {});  // it has had no frame
  for (size_t t = 0; t < from.tiles.size(); ++t) {
    const stream::ResidentStrip& strip = *from.packed[t].strip;
    const Named name{from.tiles[t].id.level, from.places[t].name, 0};
    const auto at = std::ranges::lower_bound(names_, name.key(), {}, &Named::key);
    if (at == names_.end() || at->key() != name.key()) continue;
    const stream::ResidentStrip& strip_now = *m.packed[at->tile].strip;
    const auto& now = strip_now.nodes;
    const auto first_old = old.begin() + from.tiles[t].first_slot, first_new = before_.begin() + m.tiles[at->tile].first_slot;
    if (from_before_ == Vec3{} && strip.tile.info().strip.checksum == strip_now.tile.info().strip.checksum) {  // the same bytes
      std::copy_n(first_old, now.size(), first_new);
      continue;
    }
    const float near_m = world_.levels()[name.level].cell_m / 2;
    for (uint32_t i = 0; i < std::min(now.size(), strip.nodes.size()); ++i)
      if (length(strip.nodes[i].centroid + from_before_ - now[i].centroid) < near_m) first_new[i] = first_old[i];
  }
  Vec4 light, albedo;
  for (const uint32_t s : from.leaves) {
    const Vec4 area{from.area_m2[s], from.area_m2[s], from.area_m2[s], 0};
    light = light + old[s] * area;
    albedo = albedo + from.albedo[s] * area;
  }
  for (size_t t = m.tiles.size(); t-- > 0;)  // parents first
    for (uint32_t slot = m.tiles[t].first_slot, end = slot + m.tiles[t].nodes; slot < end; ++slot) {
      if (before_[slot].x >= 0) continue;
      const uint32_t parent = m.parent_slot[slot];
      before_[slot] = parent != kNoSlot ? before_[parent] : onAlbedo(light, albedo, m.albedo[slot], {});
    }
}

// Whether the matrix has changed.
Result<bool> Updater::followCut() {
  const bool whole = std::exchange(await_cut_, false) || !started_;
  if (missed_) cut_.await();
  bool changed = false;
  if (const bool jumped = std::exchange(jumped_, false); whole || jumped) {
    fade_.finish();
    rested_frames_ = 0;
    if (jumped) frames_since_jump_ = 0;
  }
  ++frames_since_jump_;
  do {
    if (whole) cut_.await();
    if (auto asked = askForCut(whole); !asked) return asked.error();
    const auto taken = cut_.take();
    if (!taken) return taken.error();
    if (cut_.change().any || missed_) {
      changed = true;
      if (auto followed = takeUpChange(whole); !followed) return followed.error();
    } else if (*taken) {  // the same tiles, of which others fade out
      fade_.follow(matrix(), cut_.fading(), {}, observers_);
    }
    if (*taken && cut_.inBackground())
      if (auto asked = askForCut(whole); !asked) return asked.error();
  } while (whole && !cut_.holds(streamer_.active()));
  if (whole) fade_.asked();  // nothing is there that would have to go
  return changed;
}

Result<void> Updater::askForCut(bool whole) {
  const auto asked = cut_.ask({streamer_.activeList(), fade_.own(), fade_.oneHasGone(), observers_, whole});
  if (!asked) return asked.error();
  if (*asked) fade_.asked();
  return {};
}

// whole: nothing fades in.
Result<void> Updater::takeUpChange(bool whole) {
  const LocalMatrix& m = matrix();
  const MatrixChange& change = cut_.change();
  Result<void> read;
  const bool carry = started_ && (change.renumbered || missed_);
  if (carry && change.any) {
    if (missed_) {
      radiosity_.assign(before_.begin(), before_.end());
    } else if (read = solver_.radiosity(radiosity_); !read) {  // radiosity_ has the size of the matrix before
      std::fill(radiosity_.begin(), radiosity_.end(), Vec4{});
    }
    before_.assign(m.slots(), {});
    carryOver(tiles_before_, radiosity_, m, before_);
  }
  started_ = true;
  applied_tiles_ += static_cast<uint32_t>(change.entered.size());
  for (auto* per_slot : {&source_, &emission_, &radiosity_}) per_slot->resize(m.slots());
  for (auto* per_slot : {&direct_irradiance_, &lamp_irradiance_}) per_slot->resize(m.slots());
  emits_.resize(m.slots());
  if (change.renumbered) {
    std::fill(emission_.begin(), emission_.end(), Vec4{});
    std::fill(emits_.begin(), emits_.end(), uint8_t{0});
  } else {
    for (const SlotRange& range : change.left)
      if (std::exchange(emits_[range.first_slot], uint8_t{0})) std::fill_n(emission_.begin() + range.first_slot, range.nodes, Vec4{});
  }
  lightEntered(change.entered);
  ++emission_change_;
  if (m.ambient_slot != kNoSlot) source_[m.ambient_slot] = {ambient_.x, ambient_.y, ambient_.z, 0};
  counts_ = {};
  counts_.slots = m.slots();
  counts_.leaves = static_cast<uint32_t>(m.leaves.size());
  counts_.entries = m.used_entries;
  for (const SlotRange& range : m.tiles)
    if (range.id.level == 0) counts_.level0_leaves += range.nodes;
  fade_.follow(m, cut_.fading(), whole || change.renumbered ? std::span<const uint32_t>() : change.entered, observers_);
  solver_.ease(fade_.easeFrames());
  tiles_before_.assign(m.tiles.begin(), m.tiles.end());
  told_ = missed_ ? &wholeMatrix() : &change;
  emission_entered_ = !told_->renumbered;
  missed_ = true;
  if (!read) return read;
  auto told = tellSolver(*told_, carry);
  missed_ = !told;
  if (!told && !carry) before_.assign(m.slots(), {});
  return told;
}

// goes_on: from before_.
Result<void> Updater::tellSolver(const MatrixChange& change, bool goes_on) {
  if (auto updated = solver_.update(matrix(), change); !updated) return updated;
  if (goes_on)
    if (auto set = solver_.setRadiosity(before_); !set) return set;
  return change.renumbered || matrix().ambient_slot != kNoSlot ? solver_.setSource(source_) : solver_.setEnteredSource(source_, change, !relit());
}

// Direct light is asked for new tiles only; the others keep theirs.
void Updater::lightEntered(std::span<const uint32_t> entered) {
  const EnteringLight::Nodes* const made = entering_.nodes();
  size_t at = 0;
  for (size_t k = 0; k < entered.size(); ++k) {
    const uint32_t tile = entered[k];
    const SlotRange& range = matrix().tiles[tile];
    if (!made || !made->is_light) {
      light(tile, true, true);
      continue;
    }
    const auto copy = [&](const auto& from, auto& to) { std::copy_n(from.begin() + static_cast<ptrdiff_t>(at), range.nodes, to.begin() + range.first_slot); };
    copy(made->lamps, lamp_irradiance_);
    if (made->emits[k]) copy(made->emission, emission_);
    emits_[range.first_slot] = made->emits[k];
    if (direct_light_) {
      light(tile, true, false);
    } else {
      if (has_direct_) std::fill_n(direct_irradiance_.begin() + range.first_slot, range.nodes, Vec3{});
      copy(made->source, source_);
    }
    at += range.nodes;
  }
}

// The matrix as a change: for a solver that does not know what it has missed.
const MatrixChange& Updater::wholeMatrix() {
  whole_.any = whole_.renumbered = true;
  whole_.entered.clear();
  for (size_t t = matrix().tiles.size(); t-- > 0;) whole_.entered.push_back(static_cast<uint32_t>(t));
  whole_.rows = whole_.entered;
  return whole_;
}

void Updater::light(uint32_t tile, bool ask_direct_light, bool ask_lamps) {
  const SlotRange& range = matrix().tiles[tile];
  const stream::ResidentStrip& strip = cut_.strip(tile);
  const std::span<Vec3> direct = std::span(direct_irradiance_).subspan(range.first_slot, range.nodes);
  const std::span<Vec3> lamps = std::span(lamp_irradiance_).subspan(range.first_slot, range.nodes);
  if (ask_direct_light) {
    std::fill(direct.begin(), direct.end(), Vec3{});
    if (direct_light_) direct_light_(range.id, direct);
    for (uint32_t i = 0; i < range.nodes; ++i)
      direct[i] = isLight(range.first_slot + i, "", direct[i]) ? max(direct[i], {}) : Vec3{};
  }
  if (ask_lamps) {
    lamps_.irradiance(strip.lamps, lamps);
    bool emits = false;
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const Vec3 m = lamps_.emission(strip.nodes[i]);
      emission_[range.first_slot + i] = {m.x, m.y, m.z, 0};
      emits |= m != Vec3{};
    }
    emits_[range.first_slot] = emits;
  }
  for (uint32_t i = 0; i < range.nodes; ++i) {
    const formats::Node& node = strip.nodes[i];
    Vec3 m = reflectedSource(node, sky_, direct[i], lamps[i]);
    if (!isLight(range.first_slot + i, ", with lamps and the sky,", m)) m = {};
    source_[range.first_slot + i] = {m.x, m.y, m.z, 0};
  }
}

// Counts what is no light.
bool Updater::isLight(uint32_t slot, const char* what, Vec3 value) {
  const char* const why = whyNoLight(value);
  if (!why) return true;
  if (++light_zeroed_ == 1)
    light_fault_ = Error{ErrorCode::kUsage, "", nameOf(slot) + what, why, "it was taken for zero"}.line();
  return false;
}

Result<void> Updater::relightAll() {
  const LocalMatrix& m = matrix();
  for (uint32_t t = 0; t < m.tiles.size(); ++t) light(t, light_changed_, lamps_changed_);
  if (m.ambient_slot != kNoSlot) source_[m.ambient_slot] = {ambient_.x, ambient_.y, ambient_.z, 0};
  if (lamps_changed_) {
    ++emission_change_;
    emission_entered_ = false;
  }
  light_changed_ = lamps_changed_ = false;
  auto set = solver_.setSource(source_);
  sky_changed_ = !set;  // else once more in the next frame
  return set;
}

Result<Settled> Updater::converge(float tolerance, int max_iterations) {
  FF_CHECK_EQ(started_, true);
  before_.resize(matrix().slots());
  solver_.ease(0);
  return runtime::converge(solver_, {.tolerance = tolerance, .max_iterations = max_iterations}, radiosity_, before_);
}

const LocalMatrix& Updater::matrix() const { return cut_.matrix(); }

Result<void> Updater::radiosity(std::span<Vec4> out) {
  if (auto read = solver_.radiosity(out); !read) return read;
  show(out);
  return {};
}

void Updater::show(std::span<Vec4> reflected) const {
  fade_.blend(matrix(), reflected);
  for (const SlotRange& range : matrix().tiles)
    if (emits_[range.first_slot])
      for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) reflected[s] = reflected[s] + emission_[s];
}

}  // namespace ff::runtime
