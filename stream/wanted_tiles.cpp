#include "stream/wanted_tiles.h"

#include <algorithm>

#include "formats/strip_codec.h"

namespace ff::stream {

using formats::TileId;
using formats::TileInfo;

namespace {
constexpr size_t kHeapAtFirst = 65536;  // tiles that are offered and not wanted; or those of the whole world
}  // namespace

uint64_t residentBytesBound(const formats::World& world, const TileInfo& info) {
  const uint64_t partners = std::min<uint64_t>(info.entries, world.levels()[info.id.level].tiles);
  // An entry is a word and perhaps a run; counts above 255 take one more word for each 255 quanta of the row.
  const uint64_t words = uint64_t{info.entries} + uint64_t{info.nodes} * (formats::maxRowQuanta(world.info().quanta) / 255 + 1);
  // Lamps' light is among what is left of the payload once nodes and entries are taken off.
  const formats::StripLayout least{info.nodes, 0, info.entries};
  const uint64_t lamps = (info.raw_bytes - std::min<uint64_t>(info.raw_bytes, least.escapes())) / formats::StripLayout::kLampBytes;
  return sizeof(ResidentStrip) + info.nodes * sizeof(formats::Node) + partners * 4 + 16 * (uint64_t{info.nodes} + 1) +
         info.entries * sizeof(ResidentStrip::Run) + words * 2 + lamps * sizeof(formats::LampLight);
}

WantedTiles::WantedTiles(const formats::World& world, const StreamSettings& settings)
    : world_(world), settings_(settings) {
  float radius = settings.radius_m;
  size_t tiles = 0;
  for (const formats::LevelInfo& level : world.levels()) {
    radius_m_.push_back(radius);
    radius *= settings.growth;
    tiles += level.tiles;
  }
  // A tile has a node at least, and is offered once.
  most_wanted_ = std::min<size_t>(tiles, std::max(settings.max_nodes, world.levels().back().tiles));
  wanted_.reserve(most_wanted_);
  wanted_before_.reserve(most_wanted_);
  heap_.reserve(std::min(tiles, kHeapAtFirst));
}

std::span<const TileId> WantedTiles::walk(Vec3 observer) {
  wanted_before_.swap(wanted_);
  wanted_.clear();
  heap_.clear();
  bytes_ = 0;
  nodes_ = level0_nodes_ = 0;
  level0_closed_ = false;
  for (const TileInfo& info : world_.tiles(static_cast<uint32_t>(world_.levels().size() - 1))) admit(info, observer);
  while (!heap_.empty()) {
    std::pop_heap(heap_.begin(), heap_.end());
    const TileId id = heap_.back().id;
    heap_.pop_back();
    if (id.level == 0 && level0_closed_) continue;
    const TileInfo& info = world_.tiles(id.level)[id.tile];
    if (nodes_ + info.nodes > settings_.max_nodes) break;
    if (bytes_ + residentBytesBound(world_, info) > settings_.memory_bytes) break;
    if (id.level == 0 && level0_nodes_ + info.nodes > settings_.max_level0_nodes)
      level0_closed_ = true;
    else
      admit(info, observer);
  }
  std::sort(wanted_.begin(), wanted_.end());
  return wanted_;
}

void WantedTiles::admit(const TileInfo& info, Vec3 observer) {
  wanted_.push_back(info.id);
  bytes_ += residentBytesBound(world_, info);
  nodes_ += info.nodes;
  if (info.id.level == 0)
    level0_nodes_ += info.nodes;
  else
    offerChildren(info, observer);
}

void WantedTiles::offerChildren(const TileInfo& parent, Vec3 observer) {
  const uint32_t level = parent.id.level - 1;
  const auto [first, end] = world_.childTiles(parent.id);
  for (uint32_t t = first; t < end; ++t) {
    const bool stays = std::ranges::binary_search(wanted_before_, TileId{level, t});
    const float reach = radius_m_[level] * (stays ? settings_.hysteresis : 1.0f);
    const float key = world_.tiles(level)[t].bounds.distance(observer) / reach;
    if (!(key < 1)) continue;
    heap_.push_back({key, {level, t}});
    std::push_heap(heap_.begin(), heap_.end());
  }
}

}  // namespace ff::stream
