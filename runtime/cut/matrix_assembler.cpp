#include "runtime/cut/matrix_assembler.h"

#include <algorithm>
#include <array>
#include <string>
#include <utility>

namespace ff::runtime {
namespace {

using stream::ResidentStrip;
using stream::StripPtr;

constexpr size_t kTilesAtFirst = 4096;
constexpr size_t kMaxRowEntries = formats::kMaxQuanta;  // an entry has a count of 1 or more, a row at most Q
constexpr uint64_t kEntryAlignment = 16;                // a tile's rows start on a cache line

uint64_t nodesOf(const formats::World& world) {
  uint64_t nodes = 0;
  for (const formats::LevelInfo& level : world.levels()) nodes += level.nodes;
  return nodes;
}

// Entries that the largest cut may need: its slots' share of the world's, half as much again for fragmentation.
uint64_t entryCapacity(const formats::World& world, uint32_t max_slots) {
  const uint64_t nodes = nodesOf(world);
  uint64_t entries = 0;
  for (const formats::LevelInfo& level : world.levels()) entries += level.entries;
  return (entries / std::max<uint64_t>(nodes, 1) + kRowPadding) * std::min<uint64_t>(nodes, max_slots) * 3 / 2 + kEntryAlignment * kTilesAtFirst;
}

// A tile has 256 rows and shares most of their partners among them.
constexpr uint64_t kEntriesAPartner = 8;

// Ranges are not empty: a patch may see nothing but the sky.
template <class List>
uint64_t rangeOf(const List& list) {
  return std::max<uint64_t>(list.size(), 1);
}

uint64_t padded(uint64_t entries) { return (entries + kRowPadding - 1) / kRowPadding * kRowPadding; }

// Of all rows of a strip, resolved or not.
uint64_t roomOf(const ResidentStrip& strip) {
  uint64_t room = 0;
  for (size_t i = 0; i < strip.nodes.size(); ++i) room += padded(strip.row_start[i + 1] - strip.row_start[i]);
  return room;
}

uint32_t ambientOf(FarLight far_light) { return far_light == FarLight::kConstant ? 0 : kNoSlot; }

// Resolves one run (resident_strip.h) into `out`; returns the number of entries. Most columns that resolve to one slot are
// neighbours, as nodes of a tile with one ancestor are: so merging looks one back. Without a branch on that:
// most neighbours far away share a slot, but by no rule that a processor could learn. Over runs nothing is merged.
uint32_t resolveRun(const uint16_t* words, uint32_t n, const PageTable::Page& page, uint32_t* out) {
  uint32_t last = kNoSlot, sum = 0, entries = 0;
  for (uint32_t k = 0; k < n; ++k) {
    const uint32_t slot = page.slot(words[k] >> 8), count = words[k] & 0xffu;
    const uint32_t differs = slot != last, mask = 0u - differs;
    sum = (sum & ~mask) + (packEntry(slot, 0) & mask) + count;
    entries += differs;
    out[entries - 1] = sum;
    last = slot;
  }
  return entries;
}

}  // namespace

MatrixAssembler::MatrixAssembler(const formats::World& world, FarLight far_light, uint32_t max_slots)
    : world_(world),
      far_light_(far_light),
      max_slots_(max_slots),
      pages_(world, ambientOf(far_light)),
      entry_capacity_(entryCapacity(world, max_slots)),
      slots_(max_slots),
      entries_(entry_capacity_),
      partners_(entry_capacity_ / kEntriesAPartner),
      runs_(entry_capacity_) {
  tiles_.reserve(kTilesAtFirst);
  next_tiles_.reserve(kTilesAtFirst);
  kept_.reserve(kTilesAtFirst);
  partner_pages_.reserve(entry_capacity_ / kEntriesAPartner);
  run_entries_.reserve(entry_capacity_);
  columns_.reserve(kTilesAtFirst);
  scratch_.resize(kMaxRowEntries);
  change_.left.reserve(kTilesAtFirst);
  change_.entered.reserve(kTilesAtFirst);
  change_.rows.reserve(kTilesAtFirst);
  change_.pages.reserve(kTilesAtFirst);
  new_leaves_.reserve(max_slots);
  LocalMatrix& m = matrix_;
  m.tiles.reserve(kTilesAtFirst);
  m.packed.reserve(kTilesAtFirst);
  m.places.reserve(kTilesAtFirst);
  m.pages = &pages_;
  m.entries.reserve(entry_capacity_);
  m.most_slots = static_cast<uint32_t>(std::min<uint64_t>(nodesOf(world) + 1, max_slots));  // one is FarLight::kConstant's
  m.leaves.reserve(max_slots);
  m.changed_leaves.reserve(max_slots);
  m.leaf_parts.reserve(max_slots + 1);
  m.refined.reserve(max_slots);
  m.refined_level_start.reserve(formats::kMaxLevels + 1);
  for (auto* per_slot : {&m.row_start, &m.row_entries, &m.parent_slot, &m.next_sibling}) per_slot->reserve(max_slots);
  m.row_scale.reserve(max_slots);
  m.area_m2.reserve(max_slots);
  m.albedo.reserve(max_slots);
  m.leaf.reserve(max_slots);
  m.child_weight.reserve(max_slots);
  renumber();
  listLeavesAndRefined();
}

Result<void> MatrixAssembler::check(std::span<const StripPtr> active) const {
  const bool pyramid = far_light_ == FarLight::kPyramid;
  const auto top = static_cast<uint32_t>(world_.levels().size() - 1);
  uint64_t slots = pyramid ? 0 : 1, tops = 0;
  for (const StripPtr& strip : active) {
    if (!pyramid && strip->id.level != 0) continue;
    slots += strip->nodes.size();
    tops += strip->id.level == top;
  }
  if (slots > max_slots_)
    return Error{ErrorCode::kUsage, world_.path(), "",
                 std::to_string(slots) + " nodes in the cut, at most " + std::to_string(max_slots_) + " have a slot",
                 "lower the radius or max_nodes"};
  if (pyramid && tops != world_.levels()[top].tiles)
    return Error{ErrorCode::kUsage, world_.path(), "",
                 "the active tiles are not a cut: some node has no active ancestor",
                 "pass all tiles of the top level"};
  return {};
}

const FadingTile* MatrixAssembler::findFading(formats::TileId id) const {
  const auto at = std::ranges::lower_bound(fading_, id, {}, &FadingTile::id);
  return at != fading_.end() && at->id == id ? &*at : nullptr;
}

Result<void> MatrixAssembler::update(std::span<const StripPtr> active, std::span<const FadingTile> fading) {
  fading_ = fading;
  change_.any = change_.renumbered = false;
  change_.packed = nullptr;
  change_.left.clear();
  change_.entered.clear();
  change_.rows.clear();
  matrix_.changed_leaves.clear();
  change_.pages.clear();
  const auto takes_part = [this](const StripPtr& s) { return far_light_ == FarLight::kPyramid || s->id.level == 0; };
  {
    size_t t = 0;
    bool same = true;
    for (const StripPtr& strip : active) {
      if (!takes_part(strip)) continue;
      const bool there = t < tiles_.size() && tiles_[t].range.id == strip->id;
      if (!there && findFading(strip->id)) continue;
      same = same && there;
      t += there;
    }
    if (same && t == tiles_.size() && !tiles_.empty() && !renumber_next_) return {};
  }
  if (auto fit = check(active); !fit) return fit;
  change_.any = true;
  diff(active);
  bool fit_in = !std::exchange(renumber_next_, false);
  for (size_t t = 0; fit_in && t < tiles_.size(); ++t) fit_in = !tiles_[t].entered || place(tiles_[t]) || (makeRoom(tiles_[t]) && place(tiles_[t]));
  std::erase_if(tiles_, [](const Tile& tile) { return !tile.strip; });  // those that made room
  if (!fit_in) {
    renumber();  // fragmented, or larger than was foreseen
    for (Tile& tile : tiles_) place(tile);
  }
  for (size_t t = tiles_.size(); t-- > 0;) {  // parents first
    if (!tiles_[t].entered) continue;
    link(tiles_[t]);
    change_.entered.push_back(static_cast<uint32_t>(t));
  }
  matrix_.tiles.clear();
  matrix_.packed.clear();
  matrix_.places.clear();
  for (const Tile& tile : tiles_) {
    matrix_.tiles.push_back(tile.range);
    matrix_.places.push_back({tile.bounds, tile.name, tile.linked});
    matrix_.packed.push_back({tile.strip.get(), partnerPages(tile)});
  }
  const auto changed = pages_.refresh();
  change_.pages.assign(changed.begin(), changed.end());
  resolveRows();
  listLeavesAndRefined();
  for (Tile& tile : tiles_) tile.entered = false;
  return {};
}

void MatrixAssembler::pack() {
  packed_.write(matrix_, change_);
  change_.packed = &packed_;
}

// A tile keeps its slots unless its parent tile comes or goes, or gets other slots itself.
void MatrixAssembler::chooseKept(std::span<const StripPtr> active) {
  kept_.assign(active.size(), 0);
  size_t old = tiles_.size();
  for (size_t i = active.size(); i-- > 0;) {  // parents first
    const ResidentStrip& strip = *active[i];
    while (old > 0 && strip.id < tiles_[old - 1].range.id) --old;
    if (old == 0 || tiles_[old - 1].range.id != strip.id) continue;
    const bool was_linked = tiles_[old - 1].linked;
    if (far_light_ == FarLight::kConstant || strip.tile.chunk->isTop()) {
      kept_[i] = 1;
      continue;
    }
    const formats::TileId parent{strip.id.level + 1, strip.tile.info().parent_tile};
    const auto above = std::ranges::lower_bound(active, parent, {}, [](const StripPtr& s) { return s->id; });
    const bool linked = above != active.end() && (*above)->id == parent;
    kept_[i] = linked == was_linked && (!linked || kept_[static_cast<size_t>(above - active.begin())]);
  }
}

// Drops the tiles that left; tiles_ then holds the new cut, entered tiles without slots.
void MatrixAssembler::diff(std::span<const StripPtr> active) {
  next_tiles_.clear();
  size_t old = 0;
  const auto dropUpTo = [&](const formats::TileId* id) {
    for (; old < tiles_.size() && (!id || tiles_[old].range.id < *id); ++old) drop(tiles_[old]);
  };
  chooseKept(active);
  for (size_t i = 0; i < active.size(); ++i) {
    const StripPtr& strip = active[i];
    if (far_light_ == FarLight::kConstant && strip->id.level != 0) continue;
    dropUpTo(&strip->id);
    if (old < tiles_.size() && tiles_[old].range.id == strip->id) {
      if (kept_[i]) {
        next_tiles_.push_back(std::move(tiles_[old++]));
        continue;
      }
      drop(tiles_[old++]);
    }
    if (findFading(strip->id)) continue;
    Tile tile;
    tile.range = {strip->id, kNoSlot, strip->first_node, static_cast<uint32_t>(strip->nodes.size())};
    tile.strip = strip;
    tile.bounds = strip->tile.info().bounds;
    tile.name = strip->tile.name();
    tile.entered = true;
    next_tiles_.push_back(std::move(tile));
  }
  dropUpTo(nullptr);
  tiles_.swap(next_tiles_);
  next_tiles_.clear();
}

// Tiles leave the finest level first, so a parent that leaves, too, does so after its children made it a leaf.
void MatrixAssembler::drop(Tile& tile) {
  LocalMatrix& m = matrix_;
  const uint32_t end = tile.range.first_slot + tile.range.nodes;
  for (uint32_t slot = tile.range.first_slot; slot < end; ++slot) {
    const uint32_t parent = m.parent_slot[slot];
    if (parent != kNoSlot && !m.leaf[parent]) makeLeaf(parent);
    m.leaf[slot] = 0;
    m.row_entries[slot] = 0;
    m.parent_slot[slot] = kNoSlot;
  }
  pages_.setActive(tile.range.id, kNoSlot);
  for (const uint32_t page : partnerPages(tile)) pages_.release(page);
  releaseRanges(tile);
  change_.left.push_back(tile.range);
  tile.strip.reset();
}

// So many fading tiles go that a tile finds slots; false: it does not for all of them, or it is not slots that it lacks.
bool MatrixAssembler::makeRoom(const Tile& tile) {
  if (slots_.longest() >= tile.range.nodes) return false;
  do {
    // Of those that leave enough at once, the one that shows least; else the one that leaves most.
    Tile* best = nullptr;
    std::pair<uint64_t, float> most{};  // slots, up to what is enough; how little it shows
    for (Tile& other : tiles_) {
      const FadingTile* const fades = other.strip && other.placed && !other.entered ? findFading(other.range.id) : nullptr;
      if (!fades) continue;
      const std::pair leaves{std::min<uint64_t>(slots_.longWithout(other.range.first_slot, other.range.nodes), tile.range.nodes), -fades->weight};
      const std::span<const uint8_t> leaf = std::span(matrix_.leaf).subspan(other.range.first_slot, other.range.nodes);
      if ((best && leaves <= most) || std::ranges::find(leaf, 0) != leaf.end()) continue;
      best = &other;
      most = leaves;
    }
    if (!best) return false;
    drop(*best);
  } while (slots_.longest() < tile.range.nodes);
  return true;
}

void MatrixAssembler::makeLeaf(uint32_t slot) {
  matrix_.leaf[slot] = 1;
  new_leaves_.push_back(slot);
}

// Gives the tile slots and room for its entries. False: there is none (the tile is as before).
// All or nothing.
bool MatrixAssembler::reserveRanges(Tile& tile) {
  tile.room = roomOf(*tile.strip);
  const uint64_t partners = rangeOf(tile.strip->partners), runs = rangeOf(tile.strip->runs);
  const auto slot = slots_.allocate(tile.range.nodes, 1);
  const auto entry = entries_.allocate(tile.room, kEntryAlignment);
  const auto partner = partners_.allocate(partners, 1), run = runs_.allocate(runs, 1);
  if (!slot || !entry || !partner || !run) {
    if (slot) slots_.release(*slot, tile.range.nodes);
    if (entry) entries_.release(*entry, tile.room);
    if (partner) partners_.release(*partner, partners);
    if (run) runs_.release(*run, runs);
    return false;
  }
  tile.range.first_slot = static_cast<uint32_t>(*slot);
  tile.first_entry = *entry;
  tile.first_partner = *partner;
  tile.first_run = *run;
  tile.placed = true;
  if (*partner + partners > partner_pages_.size()) partner_pages_.resize(*partner + partners);
  if (*run + runs > run_entries_.size()) run_entries_.resize(*run + runs);
  return true;
}

void MatrixAssembler::releaseRanges(Tile& tile) {
  slots_.release(tile.range.first_slot, tile.range.nodes);
  entries_.release(tile.first_entry, tile.room);
  partners_.release(tile.first_partner, rangeOf(tile.strip->partners));
  runs_.release(tile.first_run, rangeOf(tile.strip->runs));
  tile.placed = false;
}

bool MatrixAssembler::place(Tile& tile) {
  if (!reserveRanges(tile)) return false;
  const ResidentStrip& strip = *tile.strip;
  LocalMatrix& m = matrix_;
  const size_t end = tile.range.first_slot + tile.range.nodes;
  if (end > m.albedo.size()) {
    for (auto* per_slot : {&m.row_start, &m.row_entries}) per_slot->resize(end, 0);
    m.parent_slot.resize(end, kNoSlot);
    m.next_sibling.resize(end, kNoSlot);
    m.row_scale.resize(end, 0);
    m.area_m2.resize(end, 0);
    m.albedo.resize(end);
    m.leaf.resize(end, 0);
  }
  if (tile.first_entry + tile.room > m.entries.size()) m.entries.resize(tile.first_entry + tile.room);
  uint64_t row_start = tile.first_entry;
  for (uint32_t i = 0; i < tile.range.nodes; ++i) {
    const formats::Node& node = strip.nodes[i];
    const size_t slot = tile.range.first_slot + i;
    m.row_start[slot] = static_cast<uint32_t>(row_start);
    row_start += padded(strip.row_start[i + 1] - strip.row_start[i]);
    m.row_scale[slot] = node.quanta ? 1.0f / static_cast<float>(node.quanta) : 0.0f;
    m.albedo[slot] = {node.albedo.x, node.albedo.y, node.albedo.z, 0};
    m.area_m2[slot] = node.area_m2;
    m.leaf[slot] = 1;
  }
  pages_.setActive(tile.range.id, tile.range.first_slot);
  const std::span<uint32_t> pages = partnerPages(tile);
  for (size_t p = 0; p < pages.size(); ++p) pages[p] = pages_.hold(*strip.chunks[strip.partners[p].chunk], strip.partners[p].tile);
  return true;
}

// Takes all slots back, and room for at least twice the entries of the present tiles; all of them enter anew.
void MatrixAssembler::renumber() {
  LocalMatrix& m = matrix_;
  for (auto* per_slot : {&m.row_start, &m.row_entries, &m.parent_slot, &m.next_sibling}) per_slot->clear();
  m.row_scale.clear();
  m.area_m2.clear();
  m.albedo.clear();
  m.leaf.clear();
  new_leaves_.clear();
  uint64_t room = 0, partners = 0, runs = 0;
  for (Tile& tile : tiles_) {
    tile.entered = true;
    pages_.setActive(tile.range.id, kNoSlot);
    if (tile.placed)
      for (const uint32_t page : partnerPages(tile)) pages_.release(page);
    tile.placed = false;
    room += roomOf(*tile.strip) + kEntryAlignment;
    partners += rangeOf(tile.strip->partners);
    runs += rangeOf(tile.strip->runs);
  }
  slots_ = RangeAllocator(max_slots_);
  entries_ = RangeAllocator(std::max(entry_capacity_, 2 * room));
  partners_ = RangeAllocator(std::max(entry_capacity_ / kEntriesAPartner, 2 * partners));
  runs_ = RangeAllocator(std::max(entry_capacity_, 2 * runs));
  if (far_light_ == FarLight::kConstant) {
    m.ambient_slot = static_cast<uint32_t>(*slots_.allocate(1, 1));
    m.row_start.push_back(0);
    m.row_entries.push_back(0);
    m.parent_slot.push_back(kNoSlot);
    m.next_sibling.push_back(kNoSlot);
    m.row_scale.push_back(0);
    m.area_m2.push_back(0);
    m.albedo.push_back({});
    m.leaf.push_back(1);
  }
  change_.renumbered = true;
}

// Parents become refined. Entered tiles are linked from the top down.
void MatrixAssembler::link(Tile& tile) {
  const uint32_t level = tile.range.id.level;
  const uint32_t first_parent =
      far_light_ == FarLight::kConstant || tile.strip->tile.chunk->isTop() ? kNoSlot : pages_.activeSlot({level + 1, tile.strip->tile.info().parent_tile});
  tile.linked = first_parent != kNoSlot;
  if (!tile.linked) return;
  const std::span<const uint8_t> parent = tile.strip->tile.parentIndex();
  std::array<uint32_t, formats::kTileNodes> last;  // child of each parent so far
  last.fill(kNoSlot);
  for (uint32_t i = 0; i < tile.range.nodes; ++i) {
    const uint32_t slot = first_parent + parent[i], own = tile.range.first_slot + i, before = std::exchange(last[parent[i]], own);
    matrix_.leaf[slot] = 0;
    matrix_.row_entries[slot] = 0;
    matrix_.parent_slot[own] = slot;
    matrix_.next_sibling[own] = before == kNoSlot ? own : std::exchange(matrix_.next_sibling[before], own);
  }
}

// Resolves a range of a row's runs into `out`; returns the number of entries. word: of the first run.
uint32_t MatrixAssembler::resolveRuns(const Tile& tile, uint32_t first, uint32_t end, uint32_t word, uint32_t* out) {
  const ResidentStrip& strip = *tile.strip;
  uint32_t entries = 0;
  for (uint32_t r = first; r < end; ++r) {
    const ResidentStrip::Run run = strip.runs[r];
    const uint32_t n = resolveRun(strip.words.data() + word, run.words, *columns_[run.partner].page, out + entries);
    run_entries_[tile.first_run + r] = static_cast<uint16_t>(n);
    entries += n;
    word += run.words;
  }
  return entries;
}

void MatrixAssembler::resolveRow(Tile& tile, uint32_t row) {
  const ResidentStrip& strip = *tile.strip;
  const uint32_t slot = tile.range.first_slot + row;
  matrix_.row_entries[slot] = resolveRuns(tile, strip.run_start[row], strip.run_start[row + 1], strip.row_start[row],
                                          matrix_.entries.data() + matrix_.row_start[slot]);
  pad(slot);
}

void MatrixAssembler::pad(uint32_t slot) {
  uint32_t* const row = matrix_.entries.data() + matrix_.row_start[slot];
  const uint32_t entries = matrix_.row_entries[slot];
  std::fill(row + entries, row + padded(entries), 0u);
}

// Resolves a row from its first to its last run in a page that changed; the rest of it only moves. Whether there is any.
bool MatrixAssembler::updateRow(Tile& tile, uint32_t row) {
  const ResidentStrip& strip = *tile.strip;
  const uint32_t slot = tile.range.first_slot + row, no_run = 0xffffffffu;
  uint32_t first = no_run, end = 0, first_word = 0, first_entry = 0, end_entry = 0;
  uint32_t word = strip.row_start[row], entry = 0;
  for (uint32_t r = strip.run_start[row]; r < strip.run_start[row + 1]; ++r) {
    const bool changed = columns_[strip.runs[r].partner].changed;
    if (changed && first == no_run) {
      first = r;
      first_word = word;
      first_entry = entry;
    }
    word += strip.runs[r].words;
    entry += run_entries_[tile.first_run + r];
    if (changed) {
      end = r + 1;
      end_entry = entry;
    }
  }
  if (first == no_run) return false;
  const uint32_t n = resolveRuns(tile, first, end, first_word, scratch_.data());
  uint32_t* const entries = matrix_.entries.data() + matrix_.row_start[slot];
  std::copy_n(entries + end_entry, entry - end_entry, scratch_.data() + n);
  std::copy_n(scratch_.data(), n + entry - end_entry, entries + first_entry);
  matrix_.row_entries[slot] = first_entry + n + entry - end_entry;
  pad(slot);
  return true;
}

void MatrixAssembler::resolveRows() {
  std::sort(new_leaves_.begin(), new_leaves_.end());
  for (size_t t = 0; t < tiles_.size(); ++t) {
    Tile& tile = tiles_[t];
    const uint32_t first = tile.range.first_slot, end = first + tile.range.nodes;
    auto new_leaf = std::lower_bound(new_leaves_.begin(), new_leaves_.end(), first);
    uint64_t changed = 0;  // bit p % 64 for each partner p whose page changed
    columns_.clear();
    const std::span<const uint32_t> partners = partnerPages(tile);
    for (size_t p = 0; p < partners.size(); ++p) {
      const uint32_t page = partners[p];
      columns_.push_back({&pages_.page(page), pages_.changed(page)});
      if (columns_[p].changed) changed |= uint64_t{1} << p % 64;
    }
    if (!tile.entered && changed == 0 && (new_leaf == new_leaves_.end() || *new_leaf >= end)) continue;
    for (uint32_t i = 0; i < tile.range.nodes; ++i) {
      const uint32_t slot = first + i;
      bool is_new = tile.entered;
      for (; new_leaf != new_leaves_.end() && *new_leaf == slot; ++new_leaf) is_new = true;
      if (!matrix_.leaf[slot]) continue;
      if (is_new)
        resolveRow(tile, i);
      else if ((changed & tile.strip->row_partners[i]) == 0 || !updateRow(tile, i))
        continue;
      matrix_.changed_leaves.push_back(slot);
    }
    change_.rows.push_back(static_cast<uint32_t>(t));
  }
  new_leaves_.clear();
}

void MatrixAssembler::listLeavesAndRefined() {
  LocalMatrix& m = matrix_;
  m.leaves.clear();
  m.refined.clear();
  m.refined_level_start.clear();
  m.used_entries = 0;
  uint32_t level = kNoSlot;
  for (const SlotRange& range : m.tiles) {
    if (range.id.level != level) {
      level = range.id.level;
      if (level + 1 < world_.levels().size()) m.refined_level_start.push_back(static_cast<uint32_t>(m.refined.size()));
    }
    for (uint32_t slot = range.first_slot; slot < range.first_slot + range.nodes; ++slot) {
      if (m.leaf[slot]) {
        m.leaves.push_back(slot);
        m.used_entries += m.row_entries[slot];
      }
      if (m.parent_slot[slot] != kNoSlot && m.next_sibling[slot] <= slot) m.refined.push_back({m.parent_slot[slot], m.next_sibling[slot], slot});
    }
  }
  if (m.ambient_slot != kNoSlot) m.leaves.push_back(m.ambient_slot);
  m.refined_level_start.push_back(static_cast<uint32_t>(m.refined.size()));
  weighChildren(m);
  divideLeaves(m);
}

Result<LocalMatrix> buildLocalMatrix(const formats::World& world, std::span<const StripPtr> active,
                                     FarLight far_light) {
  MatrixAssembler assembler(world, far_light);
  if (auto updated = assembler.update(active); !updated) return updated.error();
  return std::move(assembler).take();
}

void divideLeaves(LocalMatrix& m) {
  m.leaf_parts.assign(1, 0);
  uint32_t entries = 0;
  for (uint32_t i = 0; i < m.leaves.size(); ++i) {
    entries += m.row_entries[m.leaves[i]];
    if (entries < kPartEntries) continue;
    m.leaf_parts.push_back(i + 1);
    entries = 0;
  }
  if (m.leaf_parts.back() != m.leaves.size()) m.leaf_parts.push_back(static_cast<uint32_t>(m.leaves.size()));
}

void weighChildren(LocalMatrix& m) {
  m.child_weight.resize(m.slots());
  for (const LocalMatrix::Refined& refined : m.refined) {
    double total = 0;
    uint32_t children = 0;
    m.forEachChild(refined, [&](uint32_t c) {
      total += static_cast<double>(m.area_m2[c]);
      ++children;
    });
    m.forEachChild(refined, [&](uint32_t c) {
      m.child_weight[c] = total > 0 ? static_cast<float>(static_cast<double>(m.area_m2[c]) / total) : 1.0f / static_cast<float>(children);
    });
  }
}

uint32_t slotOf(std::span<const SlotRange> tiles, uint32_t level, uint64_t node) {
  auto after =
      std::upper_bound(tiles.begin(), tiles.end(), std::pair{level, node}, [](const auto& key, const SlotRange& r) {
        return key.first != r.id.level ? key.first < r.id.level : key.second < r.first_node;
      });
  if (after == tiles.begin()) return kNoSlot;
  const SlotRange& range = *--after;
  if (range.id.level != level || node - range.first_node >= range.nodes) return kNoSlot;
  return range.first_slot + static_cast<uint32_t>(node - range.first_node);
}

uint32_t slotFor(std::span<const SlotRange> tiles, const formats::TileRef& tile, uint32_t index) {
  for (formats::TileRef at = tile;;) {
    if (const uint32_t slot = slotOf(tiles, at.id().level, at.info().first_node + index); slot != kNoSlot) return slot;
    if (at.chunk->isTop()) return kNoSlot;
    index = at.parentIndex()[index];
    at = at.parent();
  }
}

}  // namespace ff::runtime
