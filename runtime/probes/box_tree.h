// A tree of boxes over numbered things (triangles of a tile, tiles of a world), for rays.
#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/vec3.h"

namespace ff::runtime {

struct RayLine {
  Vec3 origin, direction, inverse;  // direction: unit; inverse: 1 / direction, finite
  RayLine(Vec3 from, Vec3 to) : origin(from), direction(to) {
    for (int a = 0; a < 3; ++a) inverse[a] = std::abs(to[a]) > 1e-12f ? 1 / to[a] : std::copysign(1e12f, to[a]);
  }
};

// Where a ray is within a box, widened by `slack`: 0 <= enter <= leave; else it misses. Kay and Kajiya. Ray Tracing
// Complex Scenes. 1986.
struct Slab {
  float enter = 0, leave = 3e38f;
  Slab(const RayLine& ray, Vec3 lo, Vec3 hi, float slack) {
    for (int a = 0; a < 3; ++a) {
      const float t0 = (lo[a] - slack - ray.origin[a]) * ray.inverse[a], t1 = (hi[a] + slack - ray.origin[a]) * ray.inverse[a];
      enter = std::max(enter, std::min(t0, t1));
      leave = std::min(leave, std::max(t0, t1));
    }
  }
  bool hit() const { return enter <= leave; }
};

class BoxTree {
 public:
  BoxTree() = default;
  // Splits at the middle of the longest axis of the centres. leaf: things of a leaf, at most.
  BoxTree(std::span<const Box> boxes, uint32_t leaf);

  // Things in the order in which leaves hold them: visit() gives positions in it.
  std::span<const uint32_t> order() const { return order_; }
  uint64_t bytes() const { return nodes_.size() * sizeof(TreeNode) + order_.size() * 4; }

  // Calls visit(first, last) with ranges of order(), near ones first. It may lower `limit`: boxes that begin farther
  // are passed over.
  template <class Visit>
  void walk(const RayLine& ray, float slack, const float& limit, Visit&& visit) const {
    if (nodes_.empty()) return;
    std::array<uint32_t, kMaxDepth> stack;
    uint32_t depth = 0;
    if (const Slab root(ray, nodes_[0].lo, nodes_[0].hi, slack); root.hit() && root.enter < limit) stack[depth++] = 0;
    while (depth > 0) {
      const TreeNode& node = nodes_[stack[--depth]];
      if (node.count > 0) {
        visit(node.first, node.first + node.count);
        continue;
      }
      const uint32_t left = node.first, right = node.first + 1;
      const Slab a(ray, nodes_[left].lo, nodes_[left].hi, slack), b(ray, nodes_[right].lo, nodes_[right].hi, slack);
      const bool in_a = a.hit() && a.enter < limit, in_b = b.hit() && b.enter < limit;
      const bool a_first = a.enter <= b.enter;
      if (a_first ? in_b : in_a) stack[depth++] = a_first ? right : left;
      if (a_first ? in_a : in_b) stack[depth++] = a_first ? left : right;
    }
  }

 private:
  // Halves hold at least a thing each, and past kMaxDepth / 2 levels they are equal in number: never deeper.
  static constexpr uint32_t kMaxDepth = 96;
  struct TreeNode {
    Vec3 lo;
    uint32_t first = 0;  // child, its sibling next to it; or position of the first thing
    Vec3 hi;
    uint32_t count = 0;  // things; 0: an inner node
  };
  std::vector<TreeNode> nodes_;
  std::vector<uint32_t> order_;
};

}  // namespace ff::runtime
