// What a ray from an arbitrary point meets where no triangles are loaded: the leaves of the cut, in an octree over the grid
// cells they were made from. A leaf is the plane through its centroid, within its cell, opaque in the share of that section
// that its area fills. Planes in one cell share a ray out among them instead of rolling a
// die each: front faces block what the front faces before them have left, back faces likewise, so that terraces have no
// gaps and a thin wall's two sides have the same holes.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/read/reader.h"
#include "runtime/cut/local_matrix.h"
#include "runtime/probes/box_tree.h"

namespace ff::runtime {

// One thread. No call allocates after construction.
class ProbeTree {
 public:
  // Slots are below max_slots.
  ProbeTree(const formats::World& world, uint32_t max_slots);

  // The slot must not be in the tree. Nodes without a normal, whose pieces cancel, are left out.
  void insert(uint32_t slot, uint32_t level, const formats::Node& node);
  // No effect on a slot that is not in the tree.
  void remove(uint32_t slot);
  bool holds(uint32_t slot) const { return leaves_[slot].cell != kNone; }

  struct Hit {
    uint32_t slot = kNoSlot;  // kNoSlot: the sky
    bool front = true;
    float distance_m = 0;
  };
  // Nearest plane before limit_m, leaving out those whose `hidden` is set (by slot; empty: none). number:
  // chooses where the ray passes planes that fill only part of their cell.
  Hit nearest(const RayLine& ray, uint32_t number, float limit_m, std::span<const uint8_t> hidden) const;

 private:
  static constexpr uint32_t kNone = 0xffffffffu;
  using Coordinates = std::array<int32_t, 3>;  // of a cell, in cells of its level
  struct TreeCell {
    std::array<uint32_t, 8> child;
    uint32_t parent = kNone, first_leaf = kNone, uses = 0;  // uses: children and leaves; a free cell's parent is the next free one
  };
  struct Leaf {
    Vec3 centroid, normal;
    float coverage = 0;  // of the plane's section of the cell
    uint32_t cell = kNone, next = kNone;
  };
  struct Visit {  // without initial values: a stack of them is made for every ray
    uint32_t cell;
    int level;
    Coordinates at;
    float enter, leave;  // m along the ray
  };
  struct Query {
    const RayLine& ray;
    uint32_t number;
    std::span<const uint8_t> hidden;
  };

  float edge(int level) const { return edge_[static_cast<size_t>(level)]; }
  Coordinates cellOf(const formats::Node& node, int level) const;
  float sectionArea(const Leaf& leaf, const Coordinates& at, int level) const;
  uint32_t childOf(uint32_t cell, uint32_t which);
  bool clip(const RayLine& ray, Visit& visit) const;
  void testLeaves(const Query& query, const Visit& visit, Hit& best) const;

  float least_back_m_ = 0;   // back faces nearer than this are the surface that a probe lies on
  std::vector<float> edge_;  // of a cell, by level; the last level has at most two cells an axis
  Coordinates root_at_{};    // the lowest of those
  std::vector<TreeCell> cells_;  // [0]: the root, whose children are the cells of the last level
  uint32_t free_ = kNone;
  std::vector<Leaf> leaves_;  // by slot
};

}  // namespace ff::runtime
