#include "runtime/probes/probe_tree.h"

#include <algorithm>
#include <cmath>

namespace ff::runtime {
namespace {

// Of a cell's edge. Faces lie in the planes between cells; centroids are stored to 1/65535 of their tile's extent.
constexpr float kSlack = 4e-3f;
constexpr size_t kTreeLevels = 28;    // 2^21 cells an axis and some
constexpr uint32_t kMaxPlanes = 32;  // of one cell that a ray looks at

int32_t cellNumber(float x) { return static_cast<int32_t>(std::min(std::max(x, -1e9f), 1e9f)); }

// A number in [0, 1) for a ray in a cell. The finaliser of Appleby. MurmurHash3. 2011.
float chance(uint32_t ray, const std::array<int32_t, 3>& at, int level) {
  uint32_t h = ray * 0x9e3779b9u + static_cast<uint32_t>(level) * 0x85ebca6bu;
  for (const int32_t c : at) {
    h ^= static_cast<uint32_t>(c);
    h ^= h >> 16;
    h *= 0x85ebca6bu;
    h ^= h >> 13;
    h *= 0xc2b2ae35u;
    h ^= h >> 16;
  }
  return static_cast<float>(h >> 8) * 0x1p-24f;
}

}  // namespace

ProbeTree::ProbeTree(const formats::World& world, uint32_t max_slots) : leaves_(max_slots) {
  const Box& bounds = world.info().bounds;
  for (const formats::LevelInfo& level : world.levels()) edge_.push_back(level.cell_m);
  least_back_m_ = kSlack * edge_.front();
  // Cells to which faces in the bounds' own planes belong lie just outside them.
  const Vec3 slack = Vec3{1, 1, 1} * (2 * kSlack * edge_.back());
  const Vec3 lo = bounds.lo - slack, hi = bounds.hi + slack;
  while (std::max({hi.x - lo.x, hi.y - lo.y, hi.z - lo.z}) > edge_.back() && edge_.size() < kTreeLevels)
    edge_.push_back(2 * edge_.back());
  for (int a = 0; a < 3; ++a) root_at_[static_cast<size_t>(a)] = cellNumber(std::floor(lo[a] / edge_.back()));
  // Every cell up to the top level holds a slot's node, as the parents of active nodes are active; above the top level
  // each of its nodes has a line of cells at most.
  const size_t above = edge_.size() - world.levels().size() + 1;
  cells_.resize(1 + size_t{max_slots} + world.levels().back().nodes * above);
  for (size_t i = cells_.size(); i-- > 1;) {
    cells_[i].child.fill(kNone);
    cells_[i].parent = free_;
    free_ = static_cast<uint32_t>(i);
  }
  cells_[0].child.fill(kNone);
}

ProbeTree::Coordinates ProbeTree::cellOf(const formats::Node& node, int level) const {
  Coordinates at{};
  for (int a = 0; a < 3; ++a) {
    // A face in a plane between cells belongs to the one behind it.
    const float x = node.centroid[a] / edge(level);
    const float nearest = std::round(x), n = node.normal[a];
    const bool on_border = std::abs(x - nearest) < kSlack && std::abs(n) > 0.5f;
    at[static_cast<size_t>(a)] = cellNumber(on_border ? nearest - (n > 0 ? 1.0f : 0.0f) : std::floor(x));
  }
  return at;
}

// Area of the leaf's plane within its cell, m2: over the square of the axes across its main one, where the plane's
// height stays within the cell.
float ProbeTree::sectionArea(const Leaf& leaf, const Coordinates& at, int level) const {
  const float e = edge(level);
  const float nx = std::abs(leaf.normal.x), ny = std::abs(leaf.normal.y), nz = std::abs(leaf.normal.z);
  const int w = nx >= ny && nx >= nz ? 0 : ny >= nz ? 1 : 2, u = (w + 1) % 3, v = (w + 2) % 3;
  const auto low = [&](int a) { return static_cast<float>(at[static_cast<size_t>(a)]) * e; };
  const float nw = leaf.normal[w], nu = leaf.normal[u], nv = leaf.normal[v];
  // Height over the cell's floor at corner (x, y) of the square.
  const auto height = [&](float x, float y) {
    const float du = low(u) + x - leaf.centroid[u], dv = low(v) + y - leaf.centroid[v];
    return leaf.centroid[w] - low(w) - (nu * du + nv * dv) / nw;
  };
  struct Corner {
    float x, y;
  };
  std::array<Corner, 8> in{{{0, 0}, {e, 0}, {e, e}, {0, e}}}, out{};
  size_t corners = 4;
  // Sutherland and Hodgman. Reentrant Polygon Clipping. 1974. Against floor and ceiling, both a little wide.
  for (const float side : {1.0f, -1.0f}) {
    const auto inside = [&](Corner c) { return side * height(c.x, c.y) + (side < 0 ? e : 0) + kSlack * e; };
    size_t kept = 0;
    for (size_t i = 0; i < corners; ++i) {
      const Corner p = in[i], q = in[(i + 1) % corners];
      const float dp = inside(p), dq = inside(q);
      if (dp >= 0) out[kept++] = p;
      if ((dp < 0) != (dq < 0)) {
        const float t = dp / (dp - dq);
        out[kept++] = {p.x + t * (q.x - p.x), p.y + t * (q.y - p.y)};
      }
    }
    in = out;
    corners = kept;
  }
  float twice = 0;
  for (size_t i = 0; i < corners; ++i) {
    const Corner p = in[i], q = in[(i + 1) % corners];
    twice += p.x * q.y - q.x * p.y;
  }
  return 0.5f * std::abs(twice) / std::abs(nw);
}

uint32_t ProbeTree::childOf(uint32_t cell, uint32_t which) {
  const uint32_t there = cells_[cell].child[which];
  if (there != kNone || free_ == kNone) return there;
  const uint32_t made = free_;
  free_ = cells_[made].parent;
  cells_[made].parent = cell;
  cells_[cell].child[which] = made;
  ++cells_[cell].uses;
  return made;
}

void ProbeTree::insert(uint32_t slot, uint32_t level, const formats::Node& node) {
  FF_CHECK_EQ(holds(slot), false);
  if (node.normal == Vec3{}) return;
  Leaf& leaf = leaves_[slot];
  leaf.centroid = node.centroid;
  leaf.normal = node.normal;
  const int own = static_cast<int>(level), last = static_cast<int>(edge_.size()) - 1;
  const Coordinates at = cellOf(node, own);
  const float section = sectionArea(leaf, at, own);
  leaf.coverage = section > 0 ? std::min(1.0f, node.area_m2 / section) : 1.0f;
  uint32_t cell = 0;
  for (int l = last; l >= own; --l) {
    uint32_t which = 0;
    for (size_t a = 0; a < 3; ++a) {
      const int32_t here = at[a] >> (l - own);
      which |= static_cast<uint32_t>(l == last ? std::clamp(here - root_at_[a], 0, 1) : here & 1) << a;
    }
    const uint32_t child = childOf(cell, which);
    if (child == kNone) break;  // full: the leaf goes to a larger cell, and to the planes there
    cell = child;
  }
  leaf.cell = cell;
  leaf.next = cells_[cell].first_leaf;
  cells_[cell].first_leaf = slot;
  ++cells_[cell].uses;
}

void ProbeTree::remove(uint32_t slot) {
  if (!holds(slot)) return;
  uint32_t cell = leaves_[slot].cell;
  uint32_t* link = &cells_[cell].first_leaf;
  while (*link != slot) link = &leaves_[*link].next;
  *link = leaves_[slot].next;
  leaves_[slot] = {};
  while (--cells_[cell].uses == 0 && cell != 0) {
    const uint32_t parent = cells_[cell].parent;
    for (uint32_t& child : cells_[parent].child)
      if (child == cell) child = kNone;
    cells_[cell].parent = free_;
    free_ = cell;
    cell = parent;
  }
}

// The cell grows by the slack.
bool ProbeTree::clip(const RayLine& ray, Visit& visit) const {
  const float e = edge(visit.level);
  const Vec3 low = e * Vec3{static_cast<float>(visit.at[0]), static_cast<float>(visit.at[1]),
                                      static_cast<float>(visit.at[2])};
  const Slab slab(ray, low, low + Vec3{e, e, e}, kSlack * e);
  visit.enter = slab.enter;
  visit.leave = slab.leave;
  return slab.hit();
}

void ProbeTree::testLeaves(const Query& query, const Visit& visit, Hit& best) const {
  struct Crossing {
    float distance;
    uint32_t slot;
    bool front;
  };
  std::array<Crossing, kMaxPlanes> planes;
  uint32_t count = 0;
  for (uint32_t slot = cells_[visit.cell].first_leaf; slot != kNone; slot = leaves_[slot].next) {
    const Leaf& leaf = leaves_[slot];
    if (!query.hidden.empty() && query.hidden[slot]) continue;
    const float slope = dot(leaf.normal, query.ray.direction);
    if (std::abs(slope) < 1e-6f) continue;
    const float t = dot(leaf.normal, leaf.centroid - query.ray.origin) / slope;
    const bool front = slope < 0;
    if (t <= (front ? 0 : least_back_m_) || t < visit.enter || t > visit.leave || t >= best.distance_m) continue;
    if (count == kMaxPlanes) continue;
    uint32_t place = count++;
    for (; place > 0 && planes[place - 1].distance > t; --place) planes[place] = planes[place - 1];
    planes[place] = {t, slot, front};
  }
  if (count == 0) return;
  const float u = chance(query.number, visit.at, visit.level);
  float blocked[2] = {0, 0};  // by back and front faces so far
  for (uint32_t i = 0; i < count && planes[i].distance < best.distance_m; ++i) {
    float& so_far = blocked[planes[i].front];
    const float until = so_far + leaves_[planes[i].slot].coverage;
    if (u >= so_far && u < until) {
      best = {planes[i].slot, planes[i].front, planes[i].distance};
      return;
    }
    so_far = until;
  }
}

ProbeTree::Hit ProbeTree::nearest(const RayLine& ray, uint32_t number, float limit_m,
                                  std::span<const uint8_t> hidden) const {
  const Query query{ray, number, hidden};
  // Children nearest first: those on the side the ray comes from.
  const uint32_t far_side =
      (ray.direction.x < 0 ? 1u : 0u) | (ray.direction.y < 0 ? 2u : 0u) | (ray.direction.z < 0 ? 4u : 0u);
  std::array<Visit, 7 * kTreeLevels + 8> stack;  // a level leaves 7 behind
  size_t depth = 0;
  Hit best{kNoSlot, true, limit_m};
  const int last = static_cast<int>(edge_.size()) - 1;
  const auto offer = [&](const Visit& of, int level) {
    for (uint32_t i = 8; i-- > 0;) {
      const uint32_t which = i ^ far_side, child = cells_[of.cell].child[which];
      if (child == kNone) continue;
      Visit visit;
      visit.cell = child;
      visit.level = level;
      for (size_t a = 0; a < 3; ++a)
        visit.at[a] = (level == last ? root_at_[a] : 2 * of.at[a]) + static_cast<int32_t>(which >> a & 1);
      if (clip(ray, visit) && visit.enter < best.distance_m) stack[depth++] = visit;
    }
  };
  offer(Visit{0, last + 1, {}, 0, 0}, last);
  while (depth > 0) {
    const Visit visit = stack[--depth];
    if (visit.enter >= best.distance_m) continue;
    testLeaves(query, visit, best);
    if (visit.level > 0) offer(visit, visit.level - 1);
  }
  return best;
}

}  // namespace ff::runtime
