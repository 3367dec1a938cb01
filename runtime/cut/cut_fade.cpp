#include "runtime/cut/cut_fade.h"

#include <algorithm>
#include <utility>

#include "runtime/cut/strip_list.h"

namespace ff::runtime {
namespace {

using stream::StripPtr;

constexpr size_t kMaxTiles = kMaxSlots / 16;
constexpr float kMaxFrames = 480;      // of a tile, where nobody comes nearer or goes away
constexpr float kMaxEaseFrames = 120;  // of light, likewise
constexpr float kFades = 1.2f;         // so many times the frames that light takes it has, until it has to have followed
constexpr size_t kCrowd_percent = 50;  // of max_nodes: past it those that show least hurry, the more the less they show, so that few have to leave at once
// Of a level's radius:
constexpr float kAtHand = 0.8f;  // nearer, a tile shows what it is
constexpr float kLate = 0.9f;    // what enters nearer than that has not come by an observer's way
constexpr float kGone = 2;       // the way from where a tile leaves to where it shows nothing of its own
// Of level 0's radius:
constexpr float kAhead = 3;     // tiles on the way enter so much farther away
constexpr float kEase = 0.25f;  // the way in which light follows

}  // namespace

CutFade::CutFade(const FadeSettings& settings, std::span<const float> radii_m, uint32_t max_slots)
    : settings_(settings), radii_m_(radii_m.begin(), radii_m.end()), max_slots_(max_slots), ease_frames_(settings.frames) {
  for (auto* strips : {&cut_, &next_cut_}) strips->reserve(kMaxTiles);
  if (settings.frames == 0) return;
  for (auto* tiles : {&tiles_, &tiles_before_}) tiles->reserve(kMaxTiles);
  for (auto* known : {&active_, &active_before_, &known_, &next_known_}) known->reserve(kMaxTiles);
  fading_.reserve(kMaxTiles);
  leaving_.reserve(kMaxTiles);
  order_.reserve(kMaxTiles);
}

float CutFade::begin(const stream::Observers& observers, float frame_seconds) {
  if (settings_.frames == 0) return 0;
  const float speed = observers.fastest(), least = static_cast<float>(settings_.frames), frames = kEase * radii_m_[0] / (speed * frame_seconds);
  ease_frames_ = static_cast<uint32_t>(std::clamp(frames, least, std::max(least, kMaxEaseFrames)));
  return std::max(kFades * static_cast<float>(ease_frames_) * frame_seconds, kAhead * radii_m_[0] / speed);
}

std::span<const StripPtr> CutFade::cut(std::span<const StripPtr> active) {
  if (settings_.frames == 0) {
    if (!std::ranges::equal(active, cut_)) takeOver(cut_, active, next_cut_);
    return cut_;
  }
  if (!std::exchange(one_has_gone_, false) && std::ranges::equal(active, active_, {}, &StripPtr::get, &Known::strip)) return cut_;
  followActive(active);
  listLeaving();
  keepTheMost();
  // What stays is moved, so that no count of a strip changes.
  fading_.clear();
  size_t old = 0, a = 0;
  const auto add = [&](StripPtr strip, const Known& known) {
    next_cut_.push_back(std::move(strip));
    next_known_.push_back(known);
  };
  const auto addActive = [&](auto until) {
    for (; a < active.size() && until(active_[a].id); ++a) {
      while (old < cut_.size() && known_[old].id < active_[a].id) ++old;
      const bool stays = old < cut_.size() && known_[old].strip == active_[a].strip;
      add(stays ? std::move(cut_[old++]) : active[a], active_[a]);
    }
  };
  for (const Leaving& tile : leaving_) {
    if (!tile.kept) continue;
    addActive([id = known_[tile.at].id](formats::TileId other) { return other < id; });
    old = tile.at;
    fading_.push_back({known_[old].id, tile.weight});
    add(std::move(cut_[old]), known_[old]);
    ++old;
  }
  addActive([](formats::TileId) { return true; });
  cut_.swap(next_cut_);
  known_.swap(next_known_);
  next_cut_.clear();
  next_known_.clear();
  return cut_;
}

void CutFade::followActive(std::span<const StripPtr> active) {
  active_.swap(active_before_);
  active_.clear();
  auto old = active_before_.begin();
  for (const StripPtr& strip : active) {
    if (old == active_before_.end() || old->strip != strip.get()) {  // one that comes, or after some that went
      while (old != active_before_.end() && old->id < strip->id) ++old;
      if (old == active_before_.end() || old->strip != strip.get()) {
        active_.push_back({strip.get(), strip->id, static_cast<uint32_t>(strip->nodes.size()), strip->tile.info().parent_tile});
        continue;
      }
    }
    active_.push_back(*old++);
  }
}

// Tiles of the matrix that are active no more, kept as long as they or their descendants show anything.
void CutFade::listLeaving() {
  leaving_.clear();
  size_t a = 0;
  auto of = tiles_.begin();
  for (uint32_t k = 0; k < cut_.size(); ++k) {
    const formats::TileId id = known_[k].id;
    while (a < active_.size() && active_[a].id < id) ++a;
    while (of != tiles_.end() && of->id < id) ++of;
    if (of == tiles_.end() || of->id != id) continue;  // one that leaves before it was ever there just goes
    Tile& tile = *of;
    const bool leaves = a == active_.size() || active_[a].id != id;
    if (tile.leaving != leaves) tile.began_at_m = Tile::kUnknown;
    tile.leaving = leaves;
    tile.hurry = 0;
    if (leaves) leaving_.push_back({k, static_cast<uint32_t>(of - tiles_.begin()), tile.weight, tile.weight > 0});
  }
  for (const Leaving& tile : leaving_) {  // children first: the finest levels come first
    if (!tile.kept) continue;
    const formats::TileId parent = known_[tile.at].parentId();
    const auto above = std::ranges::lower_bound(leaving_, parent, {}, [&](const Leaving& l) { return known_[l.at].id; });
    if (above == leaving_.end() || known_[above->at].id != parent) continue;
    above->kept = true;
    above->weight = std::max(above->weight, tile.weight);
  }
}

// Within max_nodes, and what slots there are: those that show most, parents before their children.
void CutFade::keepTheMost() {
  size_t active = 0;
  for (const Known& known : active_) active += known.nodes;
  const size_t slots = max_slots_ - max_slots_ / 16;  // so that a tile that enters finds consecutive ones
  const size_t room = std::min<size_t>(settings_.max_nodes, active < slots ? slots - active : 0);
  size_t nodes = 0;
  order_.clear();
  for (uint32_t k = 0; k < leaving_.size(); ++k)
    if (leaving_[k].kept) {
      order_.push_back(k);
      nodes += known_[leaving_[k].at].nodes;
    }
  const size_t crowd = room * kCrowd_percent / 100;
  if (nodes <= crowd) return;
  std::ranges::sort(order_, [&](uint32_t x, uint32_t y) {  // of two that show as much, the coarser first
    return leaving_[x].weight != leaving_[y].weight ? leaving_[x].weight > leaving_[y].weight : x > y;
  });
  nodes = 0;
  for (const uint32_t k : order_) {
    nodes += known_[leaving_[k].at].nodes;
    leaving_[k].kept = nodes <= room;
    if (nodes > crowd) tiles_[leaving_[k].tile].hurry = std::min(static_cast<float>(nodes - crowd) / static_cast<float>(room - crowd), 1.0f);
  }
}

void CutFade::follow(const LocalMatrix& matrix, std::span<const uint32_t> entered, const stream::Observers& observers) {
  if (settings_.frames == 0) return;
  tiles_before_.swap(tiles_);  // both are sorted: tiles that stay keep their weights
  tiles_.clear();
  auto old = tiles_before_.begin();
  for (const SlotRange& range : matrix.tiles) {
    while (old != tiles_before_.end() && old->id < range.id) ++old;
    const bool stays = old != tiles_before_.end() && old->id == range.id;
    tiles_.push_back(stays ? *old : Tile{range.id});
  }
  came_late_ = false;
  for (const uint32_t t : entered) {
    if (matrix.parent_slot[matrix.tiles[t].first_slot] == kNoSlot) continue;
    tiles_[t].weight = 0;
    beginFade(tiles_[t], *matrix.packed[t].strip, observers);
    came_late_ |= late(tiles_[t]);
  }
}

void CutFade::advance(const LocalMatrix& matrix, const stream::Observers& observers) {
  const float fastest = 1 / static_cast<float>(settings_.frames), slowest = std::min(1 / kMaxFrames, fastest);
  for (size_t t = 0; t < tiles_.size(); ++t) {
    Tile& tile = tiles_[t];
    if (tile.rests()) continue;
    if (tile.began_at_m == Tile::kUnknown) beginFade(tile, *matrix.packed[t].strip, observers);
    const float away_m = observers.distance(tile.bounds);
    const float way = tile.leaving ? -1.0f : 1.0f;  // the weight's
    tile.weight = std::clamp(tile.weight + way * std::clamp(way * (due(tile, away_m) - tile.weight), std::max(slowest, tile.hurry * fastest), fastest), 0.0f, 1.0f);
    if (!tile.rests()) continue;
    tile.began_at_m = Tile::kUnknown;
    one_has_gone_ |= tile.leaving;
  }
}

void CutFade::beginFade(Tile& tile, const stream::ResidentStrip& strip, const stream::Observers& observers) {
  tile.bounds = strip.tile.info().bounds;
  tile.began_at_m = observers.distance(tile.bounds);
}

bool CutFade::late(const Tile& tile) const { return tile.began_at_m < kLate * radii_m_[tile.id.level]; }

// What a tile shows of its own by the way that the nearest observer has come, or gone, since it began.
float CutFade::due(const Tile& tile, float away_m) const {
  const float radius_m = radii_m_[tile.id.level], at_hand_m = kAtHand * radius_m;
  if (tile.leaving) return 1 - (away_m - tile.began_at_m) / (kGone * radius_m);
  if (late(tile) || away_m <= at_hand_m) return 1;
  return (tile.began_at_m - away_m) / (tile.began_at_m - at_hand_m);
}

void CutFade::finish() {
  if (settings_.frames == 0) return;
  active_.clear();
  cut_.clear();
  known_.clear();
  fading_.clear();
  for (Tile& tile : tiles_) tile = {tile.id};
}

void CutFade::blend(const LocalMatrix& matrix, std::span<Vec4> reflected) const {
  for (size_t t = tiles_.size(); t-- > 0;) {  // the coarsest first: a parent is blended before its children
    const float weight = tiles_[t].weight;
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
  for (size_t t = 0; t < tiles_.size(); ++t)
    if (tiles_[t].weight < 1) fading.push_back({matrix.tiles[t].first_slot, matrix.tiles[t].nodes, tiles_[t].weight});
}

}  // namespace ff::runtime
