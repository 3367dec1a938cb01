#include "stream/wanted_tiles.h"

#include <algorithm>
#include <cmath>

#include "formats/codec/strip_codec.h"

namespace ff::stream {

using formats::TileId;
using formats::TileInfo;

namespace {
constexpr size_t kHeapAtFirst = 65536;    // tiles that are offered and not wanted; or those of the whole world
constexpr size_t kChunksAtFirst = 4096;   // that are here, before the table takes more memory
constexpr size_t kMissingAtFirst = 1024;
constexpr float kLeastGrowth = 2.0f / 3;  // of the growth, less 1
// Of what a coarser level reaches farther than level 0 by itself, so much is taken off its lead. All of it has all levels of a place come at once, so that their fades add up; with none, single frames took
// milliseconds at 60 m/s in a town (RESULTS.md).
constexpr float kReachCounts = 0.5f;
constexpr uint32_t kWalksKept = 600;      // a chunk that so many walks have not looked at is forgotten: 10 s at 60 frames a second
}  // namespace

uint64_t residentBytesBound(const formats::World& world, const TileInfo& info) {
  const uint64_t partners = std::min<uint64_t>(info.entries, world.levels()[info.id.level].tiles);
  // An entry is a word and perhaps a run; counts above 255 take one more word for each 255 quanta of the row.
  const uint64_t words = uint64_t{info.entries} + uint64_t{info.nodes} * (formats::maxRowQuanta(world.info().quanta) / 255 + 1);
  // Lamps' light is among what is left of the payload once nodes and entries are taken off.
  const formats::StripLayout least{info.nodes, 0, 0, 0, 0, info.entries};
  const uint64_t lamps = (info.strip.raw_bytes - std::min<uint64_t>(info.strip.raw_bytes, least.end())) / formats::StripLayout::kLampBytes;
  return sizeof(ResidentStrip) + info.nodes * sizeof(formats::Node) + partners * (sizeof(ResidentStrip::Partner) + sizeof(formats::ChunkPtr)) + 16 * (uint64_t{info.nodes} + 1) +
         info.entries * sizeof(ResidentStrip::Run) + words * 2 + lamps * sizeof(formats::LampLight);
}

std::vector<float> radiiOf(const formats::World& world, float radius_0, float growth) {
  std::vector<float> radius_m(world.levels().size(), radius_0);
  for (size_t level = 1; level < radius_m.size(); ++level) radius_m[level] = radius_m[level - 1] * growth;
  return radius_m;
}

WantedTiles::WantedTiles(const formats::World& world, const StreamSettings& settings)
    : world_(world), settings_(settings), least_growth_(1 + kLeastGrowth * (settings.growth - 1)), radius_m_(radiiOf(world, settings.radius_m, settings.growth)),
      least_radius_m_(radiiOf(world, settings.radius_m, least_growth_)), shown_seconds_(world.levels().size() * kMaxObservers) {
  size_t tiles = 0;
  for (const formats::LevelInfo& level : world.levels()) tiles += level.tiles;
  // A tile has a node at least, and is offered once.
  max_wanted_ = std::min<size_t>(tiles, std::max(settings.max_nodes, world.levels().back().tiles));
  wanted_.reserve(max_wanted_);
  wanted_before_.reserve(max_wanted_);
  heap_.reserve(std::min(tiles, kHeapAtFirst));
  chunks_.reserve(kChunksAtFirst);
  missing_.reserve(kMissingAtFirst);
  asked_.reserve(kMissingAtFirst);
}

void WantedTiles::add(formats::ChunkPtr chunk) {
  const TileId id = chunk->tiles[0].id;
  chunks_[id] = {std::move(chunk), walks_};
}

void WantedTiles::forget(std::vector<std::shared_ptr<const void>>& leaving) {
  for (auto at = chunks_.begin(); at != chunks_.end() && leaving.size() < leaving.capacity();) {
    // The coarsest level's stay.
    if (at->second.chunk->isTop() || walks_ - at->second.seen < kWalksKept) {
      ++at;
      continue;
    }
    leaving.push_back(std::move(at.value().chunk));
    at = chunks_.erase(at);
  }
}

std::span<const WantedTiles::Tile> WantedTiles::walk(const Observers& observers, const Lead& lead) {
  ++walks_;
  observers_ = observers;
  turn_m_ = observers_.fastest() * lead.turn_seconds;
  active_seconds_.fill(lead.active_seconds);
  for (size_t i = 0; i < observers_.size(); ++i) {
    const float speed = length(observers_[i].velocity);
    for (size_t level = 0; level < radius_m_.size(); ++level) {
      // A tile needs its parent, so that each level goes as far ahead as level 0 at least.
      const float left = speed > 0 ? lead.shown_seconds - kReachCounts * (radius_m_[level] - radius_m_[0]) / speed : 0;
      shown_seconds_[level * kMaxObservers + i] = std::max(lead.active_seconds, left);
    }
  }
  wanted_before_.swap(wanted_);
  wanted_.clear();
  heap_.clear();
  missing_.clear();
  if (!asked_.empty()) asked_.clear();
  reach_ = {settings_.radius_m, settings_.growth};
  bytes_ = 0;
  nodes_ = level0_nodes_ = 0;
  level0_closed_ = false;
  const formats::Chunk& root = *world_.root();
  for (uint32_t k = 0; k < root.children.size(); ++k)
    if (const formats::Chunk* chunk = look(root, k))
      for (const TileInfo& info : chunk->tiles) admit({info.id, chunk});
  while (!heap_.empty()) {
    std::pop_heap(heap_.begin(), heap_.end());
    const Candidate next = heap_.back();
    const Tile& tile = next.tile;
    heap_.pop_back();
    if (tile.id.level == 0 && level0_closed_) continue;
    const TileInfo& info = tile.info();
    if (nodes_ + info.nodes > settings_.max_nodes) {
      ranOut(Budget::kNodes, next);
      break;
    }
    if (bytes_ + residentBytesBound(world_, info) > settings_.memory_bytes) {
      ranOut(Budget::kMemory, next);
      break;
    }
    if (tile.id.level == 0 && level0_nodes_ + info.nodes > settings_.max_level0_nodes) {
      ranOut(Budget::kPatches, next);
      level0_closed_ = true;
    } else {
      admit(tile);
    }
  }
  std::sort(wanted_.begin(), wanted_.end(), [](const Tile& a, const Tile& b) { return a.id < b.id; });
  std::reverse(missing_.begin(), missing_.end());  // they were found nearest first
  return wanted_;
}

// Null: it is not here, and was put on the list.
const formats::Chunk* WantedTiles::look(const formats::Chunk& parent, uint32_t child) {
  const TileId id{parent.level - 1, parent.firstTileOf(child)};
  if (const auto at = chunks_.find(id); at != chunks_.end()) {
    at.value().seen = walks_;
    return at->second.chunk.get();
  }
  if (asked_.insert(id).second) missing_.push_back({parent.shared_from_this(), child});
  return nullptr;
}

void WantedTiles::admit(const Tile& tile) {
  const TileInfo& info = tile.info();
  wanted_.push_back(tile);
  bytes_ += residentBytesBound(world_, info);
  nodes_ += info.nodes;
  if (info.id.level == 0)
    level0_nodes_ += info.nodes;
  else
    offerChildren(tile);
}

float WantedTiles::urgency(float distance, uint32_t level) const {
  if (const float beyond = (distance - radius_m_[level]) / radius_m_[level]; beyond >= 0) return kLight + (kTurn - kLight) * beyond / (1 + beyond);
  const float least = least_radius_m_[level];
  if (distance < least || !(radius_m_[level] > least)) return distance / least;
  return 1 + std::log(distance / least) / std::log(radius_m_[level] / least);  // linear in the growth's logarithm that would do, as a share of what there is
}

void WantedTiles::ranOut(Budget budget, const Candidate& at) {
  if (at.key >= kLight) return;  // all that is near is there
  if (reach_.short_of == Budget::kNone) reach_.short_of = budget;
  reach_.radius_m = std::min(reach_.radius_m, at.key * settings_.radius_m);
  if (budget != Budget::kPatches) reach_.growth = least_growth_ * std::pow(settings_.growth / least_growth_, std::clamp(at.key - 1, 0.0f, 1.0f));
}

void WantedTiles::offerChildren(const Tile& parent) {
  const uint32_t level = parent.id.level - 1;
  const TileInfo& info = parent.info();
  const uint32_t child = parent.chunk->childWith(info.first_child);
  const float wide = std::max(radius_m_[level] * settings_.hysteresis, radius_m_[level] + turn_m_);
  const std::span<const float> shown_seconds = shownSeconds(level);
  if (distance(parent.chunk->children[child].bounds, shown_seconds) >= wide) return;
  const formats::Chunk* chunk = look(*parent.chunk, child);
  if (!chunk) return;
  for (uint32_t t = info.first_child; t < info.end_child; ++t) {
    Tile tile{{level, t}, chunk};
    const Tile* const before = find(wanted_before_, tile.id);
    const Box& bounds = tile.info().bounds;
    const float stays = before && !before->spare ? settings_.hysteresis : 1;
    tile.spare = !(distance(bounds, shown_seconds) / stays < radius_m_[level]);
    const float beyond_m = tile.spare ? observers_.distance(bounds) - radius_m_[level] : 0;
    if (tile.spare && !(beyond_m < turn_m_)) continue;
    heap_.push_back({tile.spare ? kTurn + beyond_m : urgency(distance(bounds, active_seconds_) / stays, level), tile});
    std::push_heap(heap_.begin(), heap_.end());
  }
}

}  // namespace ff::stream
