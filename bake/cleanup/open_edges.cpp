#include "bake/cleanup/open_edges.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdio>
#include <deque>
#include <map>
#include <numbers>
#include <set>
#include <span>
#include <utility>
#include <vector>

#include "bake/cleanup/scene_names.h"
#include "bake/point.h"
#include "bake/rays/sobol.h"
#include "bake/rays/surface_sampling.h"
#include "bake/surface/union_find.h"

namespace ff::bake {
namespace {

constexpr double kNarrowestGap = 3e-6;  // gaps, of the largest coordinate: as far as rays start off a surface
constexpr uint32_t kAgain = 0x80000000u;
constexpr uint32_t kBatch = 1 << 16;

// Edge e is that from corner e % 3 of triangle e / 3 to the next.
class WeldedEdges {
 public:
  WeldedEdges(const Scene& scene, WorkCount& stop) : scene_(scene), stop_(stop), same_(scene.positions.size()) {
    weld();
    findOnce();
  }

  // Used once, by surface that may not end anywhere; by their first corner.
  const std::vector<uint32_t>& open() const { return open_; }
  // f(edge) for all edges of such surface, each once.
  template <class F>
  void each(F f) const {
    for (uint32_t e = 0; e < first_.size(); ++e)
      if (first_[e]) f(e);
  }

  bool isSolid(uint32_t t) const {
    const Material& m = scene_.materials[scene_.triangles[t].material];
    return !m.double_sided && !m.cutout;
  }
  uint32_t from(uint32_t e) const { return same_[scene_.triangles[e / 3].v[e % 3]]; }
  uint32_t to(uint32_t e) const { return same_[scene_.triangles[e / 3].v[(e + 1) % 3]]; }
  Point at(uint32_t corner) const { return pointOf(scene_.positions[corner]); }
  Point along(uint32_t e) const { return at(to(e)) - at(from(e)); }
  double lengthOf(uint32_t e) const { return length(along(e)); }

 private:
  // Things are looked up in a table of those of one share at a time, by hash, so that it has room in memory however many there are.
  static size_t sharesOf(size_t things) { return (things + kTableThings - 1) / kTableThings; }
  static size_t tableOf(size_t things) { return std::bit_ceil(things / std::max<size_t>(1, sharesOf(things)) * 3 / 2 + 64); }

  void weld() {
    const auto n = static_cast<uint32_t>(scene_.positions.size());
    std::vector<uint32_t> table(tableOf(n));
    const size_t shares = sharesOf(n), mask = table.size() - 1;
    for (size_t share = 0; share < shares; ++share) {
      std::fill(table.begin(), table.end(), kNone);
      for (uint32_t i = 0; i < n; ++i) {
        if (i % kBatch == 0) stop_.add(0);
        const Vec3 p = scene_.positions[i];
        uint64_t hash = 0;
        for (int k = 0; k < 3; ++k) hash = mix64(hash + std::bit_cast<uint32_t>(p[k] + 0.0f));  // -0 is 0
        if ((hash >> 32) % shares != share) continue;
        size_t slot = hash & mask;
        while (table[slot] != kNone && !(scene_.positions[table[slot]] == p)) slot = (slot + 1) & mask;
        if (table[slot] == kNone) table[slot] = i;
        same_[i] = table[slot];
      }
    }
  }

  void findOnce() {
    struct Edge {
      uint32_t a, b;     // corners, the lower number first
      uint32_t edge;     // the first of these; with kAgain where others are equal
    };
    const auto n = 3 * static_cast<uint32_t>(scene_.triangles.size());
    first_.resize(n);
    std::vector<Edge> table(tableOf(n));
    const size_t shares = sharesOf(n), mask = table.size() - 1;
    for (size_t share = 0; share < shares; ++share) {
      std::fill(table.begin(), table.end(), Edge{0, 0, kNone});
      for (uint32_t e = 0; e < n; ++e) {
        if (e % kBatch == 0) stop_.add(0);
        const auto [a, b] = std::minmax({from(e), to(e)});
        const uint64_t hash = mix64(mix64(a) + b);
        if ((hash >> 32) % shares != share) continue;
        size_t slot = hash & mask;
        while (table[slot].edge != kNone && (table[slot].a != a || table[slot].b != b)) slot = (slot + 1) & mask;
        if (table[slot].edge == kNone) table[slot] = {a, b, e};
        else table[slot].edge |= kAgain;
      }
      for (const Edge& at : table) {
        const uint32_t e = at.edge & ~kAgain;
        if (at.edge == kNone || !isSolid(e / 3)) continue;
        first_[e] = true;
        if (e == at.edge) open_.push_back(e);
      }
    }
    std::sort(open_.begin(), open_.end(), [&](uint32_t a, uint32_t b) { return std::pair(from(a), a) < std::pair(from(b), b); });
  }

  static constexpr size_t kTableThings = size_t{1} << 22;

  const Scene& scene_;
  WorkCount& stop_;
  PagedVector<uint32_t> same_;   // of a position: the first that is equal
  std::vector<bool> first_;      // of an edge of solid surface: whether it is the first of those that are equal
  std::vector<uint32_t> open_;
};

// Open edges that follow each other until they close, or end.
struct OpenLoop {
  uint32_t surface = 0;        // by name of its connected surface
  std::vector<uint32_t> edges;
  std::vector<Point> outline;  // without what goes there and back on itself: corners on others' edges
  Point area{};                // of the surface that it borders, m2, along its normal: against that of what is missing
  double largest = 0;          // coordinate
  Box box;
  bool at_border = true;       // all of it, of the scene's box, but for its top

  double area_m2() const { return length(area); }
  double length_m() const {
    double sum = 0;
    for (size_t i = 0; i < outline.size(); ++i) sum += length(outline[(i + 1) % outline.size()] - outline[i]);
    return sum;
  }
  Point middle() const {
    Point sum{};
    for (const Point& p : outline) sum = sum + p;
    return sum / static_cast<double>(outline.size());
  }
  // No gap: twice the area over the perimeter is the width of a long one.
  bool isNarrow() const { return outline.empty() || 2 * area_m2() <= kNarrowestGap * largest * length_m(); }
  bool isCrack() const { return 4 * std::numbers::pi * area_m2() <= kCrack * length_m() * length_m(); }

  void findOutline(const WeldedEdges& all) {
    const auto isSpike = [&](const Point& p, const Point& q, const Point& r) {
      const Point there = q - p, back = r - q;
      return dot(there, back) <= 0 && length(cross(there, back)) <= kNarrowestGap * largest * std::max(length(there), length(back));
    };
    std::deque<Point> points;
    for (const uint32_t e : edges) {
      points.push_back(all.at(all.from(e)));
      while (points.size() > 2 && isSpike(points[points.size() - 3], points[points.size() - 2], points.back())) points.erase(points.end() - 2);
    }
    for (bool changed = true; changed && points.size() > 2;) {
      changed = false;
      if (isSpike(points[points.size() - 2], points.back(), points.front())) changed = true, points.pop_back();
      else if (isSpike(points.back(), points.front(), points[1])) changed = true, points.pop_front();
    }
    if (points.size() > 2) outline.assign(points.begin(), points.end());
  }
};

class Tracer {
 public:
  Tracer(const WeldedEdges& edges, std::span<const uint32_t> open, const Box& scene) : edges_(edges), open_(open), scene_(scene), done_(open.size()) {}

  std::vector<OpenLoop> loops() {
    std::vector<OpenLoop> loops;
    for (size_t first = 0; first < open_.size(); ++first) {
      if (done_[first]) continue;
      OpenLoop& loop = loops.emplace_back();
      const Point start = edges_.at(edges_.from(open_[first]));
      for (size_t k = first; k < open_.size(); k = next(open_[k])) {
        done_[k] = true;
        add(loop, open_[k], start);
        if (edges_.to(open_[k]) == edges_.from(open_[first])) break;
      }
      loop.findOutline(edges_);
    }
    return loops;
  }

 private:
  // The one that turns back most sharply, so that edges which lie on each other close at once.
  size_t next(uint32_t e) const {
    const uint32_t corner = edges_.to(e);
    const auto first = std::lower_bound(open_.begin(), open_.end(), corner, [&](uint32_t o, uint32_t c) { return edges_.from(o) < c; });
    size_t best = open_.size();
    double least = 2;
    for (auto k = static_cast<size_t>(first - open_.begin()); k < open_.size() && edges_.from(open_[k]) == corner; ++k) {
      if (done_[k]) continue;
      const double straight = dot(edges_.along(e), edges_.along(open_[k])) / (edges_.lengthOf(e) * edges_.lengthOf(open_[k]));
      if (straight >= least) continue;
      least = straight;
      best = k;
    }
    return best;
  }

  void add(OpenLoop& loop, uint32_t e, const Point& start) const {
    const Point a = edges_.at(edges_.from(e)), b = edges_.at(edges_.to(e));
    loop.edges.push_back(e);
    loop.area = loop.area + cross(a - start, b - start) / 2;
    for (int c = 0; c < 3; ++c) loop.largest = std::max(loop.largest, std::abs(a[c]));
    loop.box.add(vec3Of(a));
    const auto on = [&](int k, float plane) { return a[k] == static_cast<double>(plane) && b[k] == static_cast<double>(plane); };
    loop.at_border = loop.at_border && (on(0, scene_.lo.x) || on(0, scene_.hi.x) || on(2, scene_.lo.z) || on(2, scene_.hi.z) || on(1, scene_.lo.y));
  }

  const WeldedEdges& edges_;
  const std::span<const uint32_t> open_;
  const Box scene_;
  std::vector<bool> done_;
};

// Connected surface with holes.
struct HoledSurface {
  double area_m2 = 0, length_m = 0, open_m = 0, hole_m2 = 0, volume_m3 = 0;  // hole_m2: of the largest
  Point holes{}, within{};  // within: the largest hole
  bool isNearlyClosed() const { return open_m > 0 && open_m <= kMaxOpen * length_m && length(holes) <= kMaxHole * area_m2; }
  bool isRoom() const { return volume_m3 < 0; }
};

// Whether something lies across a hole, or it is inside of another solid.
bool isCovered(const Scene& scene, const RayCaster& caster, const OpenLoop& loop) {
  constexpr double kInside = 0.01, kCloseBy = 0.07, kOffMiddle = 0.7;  // of the hole's breadth; from its middle to its corners
  const double breadth = length(pointOf(loop.box.hi) - pointOf(loop.box.lo));
  const Point out = loop.area * (-1 / loop.area_m2()), middle = loop.middle();
  uint32_t samples = 0, covered = 0;
  const size_t step = (loop.outline.size() + kSamples - 1) / kSamples;
  for (size_t k = 0; k < loop.outline.size(); k += step, ++samples) {
    const Point on = middle + (loop.outline[k] - middle) * kOffMiddle;
    const Vec3 origin = vec3Of(on - out * (kInside * breadth));
    const Hit hit = caster.nearest({origin, normalized(vec3Of(out))});
    if (hit.triangle == kNone) continue;
    const bool back = !hit.front && !scene.materials[scene.triangles[hit.triangle].material].double_sided;
    const bool close_by = static_cast<double>(length(hit.point - origin)) < kCloseBy * breadth;
    covered += back != close_by;  // a back close by is a lid that does not fit
  }
  return 2 * covered > samples;
}

// The middle of the outline's longest side, and a triangle at its start.
std::pair<uint32_t, Vec3> placeOf(const WeldedEdges& edges, const OpenLoop& loop) {
  size_t longest = 0;
  double longest_m = -1;
  const auto end = [&](size_t i) { return loop.outline[(i + 1) % loop.outline.size()]; };
  for (size_t i = 0; i < loop.outline.size(); ++i) {
    const double own = length(end(i) - loop.outline[i]);
    if (own <= longest_m) continue;
    longest_m = own;
    longest = i;
  }
  const Point start = loop.outline[longest];
  const auto there = std::find_if(loop.edges.begin(), loop.edges.end(), [&](uint32_t e) { return length(edges.at(edges.from(e)) - start) == 0; });
  return {*there / 3, vec3Of((start + end(longest)) / 2)};
}

}  // namespace

std::optional<Finding> findOpenEdges(const Scene& scene, const RayCaster& caster, WorkCount& stop) {
  if (scene.backs != Backs::kAbsorb || scene.triangles.size() >= kAgain / 3) return {};
  const WeldedEdges edges(scene, stop);
  const std::vector<uint32_t>& open = edges.open();
  if (open.empty()) return {};
  Box box;
  UnionFind connected(scene.positions.size());
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    if (t % kBatch == 0) stop.add(0);
    for (const uint32_t v : scene.triangles[t].v) box.add(scene.positions[v]);
    if (!edges.isSolid(t)) continue;
    for (const uint32_t e : {3 * t, 3 * t + 1}) connected.join(edges.from(e), edges.to(e));
  }
  std::vector<OpenLoop> loops = Tracer(edges, open, box).loops();
  const Vec3 breadth = box.hi - box.lo;
  const auto isUnderside = [&](const OpenLoop& loop) {
    const Vec3 own = loop.box.hi - loop.box.lo;
    return loop.area.y > loop.area_m2() / 2 && static_cast<double>(own.x) > kGround * static_cast<double>(breadth.x) &&
           static_cast<double>(own.z) > kGround * static_cast<double>(breadth.z);
  };
  const bool is_ground = std::any_of(loops.begin(), loops.end(), isUnderside);
  std::erase_if(loops, [&](const OpenLoop& loop) { return loop.isNarrow() || (is_ground && (loop.at_border || isUnderside(loop))); });
  if (loops.empty()) return {};

  std::map<uint32_t, HoledSurface> surfaces;
  for (OpenLoop& loop : loops) {
    loop.surface = connected.find(edges.from(loop.edges[0]));
    HoledSurface& surface = surfaces[loop.surface];
    surface.open_m += loop.length_m();
    surface.holes = surface.holes + loop.area;
    if (loop.area_m2() > surface.hole_m2) {
      surface.hole_m2 = loop.area_m2();
      surface.within = loop.middle();
    }
  }
  const auto with = [&](uint32_t corner) {
    const auto at = surfaces.find(connected.find(corner));
    return at == surfaces.end() ? nullptr : &at->second;
  };
  double whole = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    if (t % kBatch == 0) stop.add(0);
    const auto area = static_cast<double>(triangleArea(scene, t));
    whole += area;
    HoledSurface* surface = edges.isSolid(t) ? with(edges.from(3 * t)) : nullptr;
    if (!surface) continue;
    surface->area_m2 += area;
    const auto corner = [&](uint32_t k) { return edges.at(edges.from(3 * t + k)) - surface->within; };
    surface->volume_m3 += dot(corner(0), cross(corner(1), corner(2))) / 6;
  }
  edges.each([&](uint32_t e) {
    if (HoledSurface* surface = with(edges.from(e))) surface->length_m += edges.lengthOf(e);
  });

  Finding finding{"open_edges", "", 0, "edges", 0, "surface"};
  PlaceSums places(scene);
  double length_m = 0;
  std::set<uint32_t> pieces;
  for (const OpenLoop& loop : loops) {
    const HoledSurface& surface = surfaces[loop.surface];
    if (!surface.isNearlyClosed() || (!loop.isCrack() && (surface.isRoom() || isCovered(scene, caster, loop)))) continue;
    stop.add(0);
    finding.count += loop.outline.size();
    length_m += loop.length_m();
    if (pieces.insert(loop.surface).second) finding.share += surface.area_m2 / whole;
    const auto [triangle, at] = placeOf(edges, loop);
    places.add(triangle, loop.length_m(), at);
  }
  if (pieces.empty()) return {};
  char text[200];
  std::snprintf(text, sizeof text, "%llu open edges, %.3g m together, border holes or cracks in %s of surface that %s nearly closed", static_cast<unsigned long long>(finding.count),
                length_m, counted(pieces.size(), "piece").c_str(), pieces.size() == 1 ? "is" : "are");
  finding.what = text;
  places.putInto(finding);
  finding.remedy = "close them, or make the material double-sided";
  return finding;
}

}  // namespace ff::bake
