#include "runtime/local_matrix.h"

#include <algorithm>

#include "runtime/page_table.h"

namespace ff::runtime {
namespace {

using Strips = std::span<const std::shared_ptr<const formats::Strip>>;

// Rows of the strips in slot order, columns resolved and merged.
class RowBuilder {
 public:
  RowBuilder(LocalMatrix& matrix, PageTable& pages, size_t entries_bound) : matrix_(matrix), pages_(pages) {
    matrix_.entries.resize(entries_bound);
    position_of_slot_.resize(kMaxSlots);
  }

  // Appends the rows of all nodes of the strip; refined slots get empty ones.
  void add(const formats::Strip& strip, uint32_t first_slot) {
    const bool any_leaf =
        std::any_of(matrix_.leaf.begin() + first_slot,
                    matrix_.leaf.begin() + first_slot + static_cast<std::ptrdiff_t>(strip.nodes.size()),
                    [](uint8_t leaf) { return leaf != 0; });
    if (any_leaf) sortByRow(strip);
    for (size_t i = 0; i < strip.nodes.size(); ++i) {
      if (matrix_.leaf[first_slot + i])
        appendMerged({by_row_.data() + row_start_[i], row_start_[i + 1] - row_start_[i]});
      matrix_.row_start.push_back(size_);
    }
  }

  void finish() { matrix_.entries.resize(size_); }

 private:
  // A strip's entries are sorted by (partner, row, column); a stable counting sort brings rows together.
  void sortByRow(const formats::Strip& strip) {
    row_start_.fill(0);
    for (const uint8_t row : strip.rows) ++row_start_[row + 1u];
    for (size_t i = 1; i < row_start_.size(); ++i) row_start_[i] += row_start_[i - 1];
    std::copy(row_start_.begin(), row_start_.end() - 1, cursor_.begin());
    by_row_.resize(strip.rows.size());
    size_t k = 0;
    for (const formats::Block& block : strip.blocks) {
      const PageTable::Page& page = pages_.page(pages_.pageOf({strip.id.level, block.partner_tile}));
      for (const size_t end = k + block.entries; k < end; ++k)
        by_row_[cursor_[strip.rows[k]]++] = uint32_t{page[strip.columns[k]]} << 16 | strip.counts[k];
    }
  }

  // Columns that resolve to one slot become one entry; the sum of a row's counts is at most Q, so 16 bits hold it.
  // Whether a slot was met in this row is read off the sparse set's own contents, so nothing has to be cleared between
  // rows. Briggs and Torczon. An Efficient Representation for Sparse Sets. 1993.
  void appendMerged(std::span<const uint32_t> row) {
    uint32_t* const entries = matrix_.entries.data();
    const uint32_t begin = size_;
    uint32_t end = begin;
    for (const uint32_t entry : row) {
      const uint32_t slot = entry >> 16;
      const uint32_t at = position_of_slot_[slot];
      if (at >= begin && at < end && entries[at] >> 16 == slot) {
        entries[at] += entry & 0xffff;
      } else {
        position_of_slot_[slot] = end;
        entries[end++] = entry;
      }
    }
    size_ = end;
  }

  LocalMatrix& matrix_;
  PageTable& pages_;
  uint32_t size_ = 0;
  std::array<uint32_t, formats::kTileNodes + 1> row_start_{};
  std::array<uint32_t, formats::kTileNodes> cursor_{};
  std::vector<uint32_t> by_row_, position_of_slot_;
};

// Marks the parents of active tiles' nodes as refined. Tiles are sorted finest level first, and so is the list.
void listRefined(const formats::World& world, LocalMatrix& matrix) {
  uint32_t level = kNoSlot;
  for (const SlotRange& range : matrix.tiles) {
    if (range.id.level + 1 >= world.levels().size()) break;
    if (range.id.level != level) {
      level = range.id.level;
      matrix.refined_level_start.push_back(static_cast<uint32_t>(matrix.refined.size()));
    }
    uint32_t last_parent = formats::kNoParent;
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const uint32_t parent = world.parent(level, range.first_node + i);
      if (parent == last_parent) {
        ++matrix.refined.back().children;
        continue;
      }
      last_parent = parent;
      const uint32_t slot = matrix.slotOf(level + 1, parent);
      matrix.refined.push_back({slot, range.first_slot + i, 1});
      if (slot != kNoSlot) matrix.leaf[slot] = 0;
    }
  }
  matrix.refined_level_start.push_back(static_cast<uint32_t>(matrix.refined.size()));
}

}  // namespace

uint32_t LocalMatrix::slotOf(uint32_t level, uint32_t node) const {
  auto after =
      std::upper_bound(tiles.begin(), tiles.end(), std::pair{level, node}, [](const auto& key, const SlotRange& r) {
        return key.first != r.id.level ? key.first < r.id.level : key.second < r.first_node;
      });
  if (after == tiles.begin()) return kNoSlot;
  const SlotRange& range = *--after;
  if (range.id.level != level || node - range.first_node >= range.nodes) return kNoSlot;
  return range.first_slot + (node - range.first_node);
}

Result<LocalMatrix> buildLocalMatrix(const formats::World& world, Strips active, FarLight far_light) {
  const bool pyramid = far_light == FarLight::kPyramid;
  LocalMatrix matrix;
  size_t slots = 0, entries = 0;
  for (const auto& strip : active) {
    if (!pyramid && strip->id.level != 0) continue;
    const uint32_t nodes = static_cast<uint32_t>(strip->nodes.size());
    matrix.tiles.push_back({strip->id, static_cast<uint32_t>(slots), strip->first_node, nodes});
    slots += nodes;
    entries += strip->counts.size();
  }
  const uint32_t ambient = pyramid ? kNoSlot : static_cast<uint32_t>(slots++);
  if (slots > kMaxSlots)
    return Error{ErrorCode::kUsage, world.path(), "",
                 std::to_string(slots) + " nodes in the cut, at most " + std::to_string(kMaxSlots) + " have a slot",
                 "lower the radius or max_nodes"};

  matrix.leaf.assign(slots, 1);
  PageTable pages(world, matrix.tiles, ambient);
  if (pyramid)
    listRefined(world, matrix);
  else
    matrix.refined_level_start.push_back(0);

  matrix.albedo.reserve(slots);
  matrix.area_m2.reserve(slots);
  matrix.row_scale.reserve(slots);
  matrix.row_start.reserve(slots + 1);
  matrix.row_start.push_back(0);
  RowBuilder rows(matrix, pages, entries);
  size_t next = 0;
  for (const auto& strip : active) {
    if (next == matrix.tiles.size() || matrix.tiles[next].id != strip->id) continue;
    for (const formats::Node& node : strip->nodes) {
      matrix.albedo.push_back({node.albedo.x, node.albedo.y, node.albedo.z, 0});
      matrix.area_m2.push_back(node.area_m2);
      matrix.row_scale.push_back(node.quanta ? 1.0f / static_cast<float>(node.quanta) : 0.0f);
    }
    rows.add(*strip, matrix.tiles[next++].first_slot);
  }
  if (!pyramid) {
    matrix.albedo.push_back({});
    matrix.area_m2.push_back(0);
    matrix.row_scale.push_back(0);
    matrix.row_start.push_back(matrix.row_start.back());
  }
  rows.finish();
  const bool orphan = std::any_of(matrix.refined.begin(), matrix.refined.end(),
                                  [](const LocalMatrix::Refined& r) { return r.slot == kNoSlot; });
  if (pages.incomplete() || orphan)
    return Error{ErrorCode::kUsage, world.path(), "",
                 "the active tiles are not a cut: some node has no active ancestor",
                 "pass all tiles of the top level and the ancestors of every active tile"};
  return matrix;
}

}  // namespace ff::runtime
