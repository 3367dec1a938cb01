#include "runtime/cut/cut_fade.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace ff::runtime {
namespace {

constexpr size_t kMaxTiles = kMaxSlots / 16;
constexpr float kMaxFrames = 480;      // of a tile, where nobody comes nearer or goes away
constexpr float kMaxEaseFrames = 120;  // of light, likewise
constexpr float kHeadingFrames = 30;   // of an observer's mean velocity
constexpr float kStraight = 0.87f;     // cosine: who goes farther off that turns
constexpr float kFades = 1.2f;         // so many times the frames that light takes it has, until it has to have followed
constexpr float kAtHand = 0.8f;        // of a level's radius: nearer, a tile shows what it is
constexpr float kGone = 2;             // of the geometric mean of level 0's radius and a level's: the way from where a tile leaves to where it shows nothing of its own
// Of level 0's radius:
constexpr float kAhead = 4, kLeastAhead = 2.6f;  // tiles on the way enter so much farther away at most, and at least: fast observers need more of a way
constexpr float kAhead_seconds = 1.4f;           // and between these two so long before they have to
constexpr float kEase = 0.25f;  // the way in which light follows

// What an observer has of the way between two distances: a metre of it counts as the fourth power of the distance. So what is seen as large changes slowly.
float shareOfWay(float from_m, float to_m, float at_m) {
  const auto until = [](float m) { return m * m * m * m * m; };
  return (until(at_m) - until(from_m)) / (until(to_m) - until(from_m));
}

}  // namespace

CutFade::CutFade(const FadeSettings& settings, std::span<const float> radii_m) : settings_(settings), radii_m_(radii_m.begin(), radii_m.end()), ease_frames_(settings.frames) {
  if (settings.frames == 0) return;
  for (auto* own : {&own_, &own_before_}) own->reserve(kMaxTiles);
  for (auto* ids : {&ids_, &ids_before_}) ids->reserve(kMaxTiles);
  for (auto* fades : {&fades_, &fades_before_}) fades->reserve(kMaxTiles);
}

float CutFade::begin(const stream::Observers& observers, float frame_seconds) {
  turns_ = false;
  for (size_t i = 0; i < observers.size(); ++i) {
    const Vec3 velocity = observers[i].velocity;
    headings_[i] += (velocity - headings_[i]) * (1 / kHeadingFrames);
    turns_ |= dot(headings_[i], velocity) < kStraight * length(headings_[i]) * length(velocity);
  }
  if (settings_.frames == 0) return 0;
  const float speed = observers.fastest(), least = static_cast<float>(settings_.frames), frames = kEase * radii_m_[0] / (speed * frame_seconds);
  ease_frames_ = static_cast<uint32_t>(std::clamp(frames, least, std::max(least, kMaxEaseFrames)));
  const float ahead_m = std::clamp(kAhead_seconds * speed, kLeastAhead * radii_m_[0], kAhead * radii_m_[0]);
  return std::max(kFades * static_cast<float>(ease_frames_) * frame_seconds, ahead_m / speed);
}

void CutFade::follow(const LocalMatrix& matrix, std::span<const FadingTile> fading, std::span<const uint32_t> entered, const stream::Observers& observers) {
  if (settings_.frames == 0) return;
  own_before_.swap(own_);  // all lists are sorted: tiles that stay go on
  ids_before_.swap(ids_);
  fades_before_.swap(fades_);
  own_.assign(matrix.tiles.size(), 1);
  ids_.clear();
  fades_.clear();
  came_late_ = false;
  size_t old = 0, old_fade = 0, out = 0, in = entered.size();  // entered: the coarsest, which have the highest numbers, first
  for (uint32_t t = 0; t < matrix.tiles.size(); ++t) {
    const formats::TileId id = matrix.tiles[t].id;
    ids_.push_back(id);
    while (old < ids_before_.size() && ids_before_[old] < id) ++old;
    while (in > 0 && entered[in - 1] < t) --in;
    const bool enters = in > 0 && entered[in - 1] == t, stays = !enters && old < ids_before_.size() && ids_before_[old] == id;
    if (stays) own_[t] = own_before_[old];
    if (enters && matrix.places[t].linked) own_[t] = 0;
    while (out < fading.size() && fading[out].id < id) ++out;
    const bool leaving = out < fading.size() && fading[out].id == id;
    if (own_[t] == (leaving ? 0.0f : 1.0f)) continue;  // it rests
    while (old_fade < fades_before_.size() && fades_before_[old_fade].tile < old) ++old_fade;
    const Fade* const before = stays && old_fade < fades_before_.size() && fades_before_[old_fade].tile == old ? &fades_before_[old_fade] : nullptr;
    const float hurry = leaving ? fading[out].hurry : 0;
    if (before && before->leaving == leaving) {
      fades_.push_back(*before);
      fades_.back().tile = t;
      fades_.back().hurry = hurry;
      continue;
    }
    fades_.push_back({t, id.level, leaving, hurry, observers.distance(matrix.places[t].bounds), matrix.places[t].bounds});
    came_late_ |= enters && late(fades_.back());
  }
}

void CutFade::advance(const stream::Observers& observers) {
  const float fastest = 1 / static_cast<float>(settings_.frames), slowest = std::min(1 / kMaxFrames, fastest);
  std::erase_if(fades_, [&](const Fade& fade) {
    float& own = own_[fade.tile];
    const float way = fade.leaving ? -1.0f : 1.0f;  // the weight's
    const float step = std::clamp(way * (due(fade, observers.distance(fade.bounds)) - own), std::max(slowest, fade.hurry * fastest), fastest);
    own = std::clamp(own + way * step, 0.0f, 1.0f);
    const bool rests = own == (fade.leaving ? 0.0f : 1.0f);
    one_has_gone_ |= rests && fade.leaving;
    return rests;
  });
}

// What a tile shows of its own by the way that the nearest observer has come, or gone, since it began.
float CutFade::due(const Fade& fade, float away_m) const {
  const float at_hand_m = kAtHand * radii_m_[fade.level];
  if (fade.leaving) return 1 - shareOfWay(fade.began_at_m, fade.began_at_m + kGone * std::sqrt(radii_m_[0] * radii_m_[fade.level]), away_m);
  if (late(fade) || away_m <= at_hand_m) return 1;
  return shareOfWay(fade.began_at_m, at_hand_m, away_m);
}

void CutFade::finish() {
  std::ranges::fill(own_, 1.0f);
  fades_.clear();
  lets_go_ = one_has_gone_ = true;
}

void CutFade::blend(const LocalMatrix& matrix, std::span<Vec4> reflected) const {
  for (size_t t = own_.size(); t-- > 0;) {  // the coarsest first: a parent is blended before its children
    const float weight = own_[t];
    if (weight == 1) continue;
    const SlotRange& range = matrix.tiles[t];
    for (uint32_t slot = range.first_slot; slot < range.first_slot + range.nodes; ++slot) {
      const uint32_t parent = matrix.parent_slot[slot];
      if (parent == kNoSlot) continue;
      const Vec4 own = reflected[slot], above = onAlbedo(reflected[parent], matrix.albedo[parent], matrix.albedo[slot], own);
      const auto mix = [&](float b, float over) { return b + (1 - weight) * (over - b); };
      reflected[slot] = {mix(own.x, above.x), mix(own.y, above.y), mix(own.z, above.z), 0};
    }
  }
}

void CutFade::fadingSlots(const LocalMatrix& matrix, std::vector<shaders::FadingSlots>& fading) const {
  fading.clear();
  for (size_t t = 0; t < own_.size(); ++t)
    if (own_[t] < 1) fading.push_back({matrix.tiles[t].first_slot, matrix.tiles[t].nodes, own_[t]});
}

}  // namespace ff::runtime
