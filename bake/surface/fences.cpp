#include "bake/surface/fences.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include "bake/rays/surface_sampling.h"
#include "bake/surface/fineness.h"
#include "bake/surface/union_find.h"

namespace ff::bake {
namespace {

constexpr double kHairCells = 1e-3;
constexpr double kLowCells = 0.1;     // what hangs lower over a surface parts it, too,
constexpr double kLeastUnder = 0.05;  // of a cell's face: where its pieces are as large
constexpr double kHairsOffBorder = 0.25;  // a fence so near a border stands on it
constexpr size_t kMaxFences = 256, kMaxParts = 256;  // of a piece: past them, the longest fences count
constexpr int kLooks = 8;  // along a border
constexpr double kAwayCells = 0.25;  // as far as shareSpace() goes away from surface

struct Plane {
  Point at, normal;
  double above(const Point& p) const { return dot(normal, p - at); }
};

// A triangle that rises through the plane a hair above a surface: `above` is where it does, `foot` where it stands. Both lie in
// the surface's plane.
struct Fence {
  Segment above, foot;
};

bool fenceOf(const Plane& plane, const std::array<Point, 3>& corners, double hair, Fence* fence) {
  std::array<double, 3> z;
  for (size_t k = 0; k < 3; ++k) z[k] = plane.above(corners[k]);
  const auto [lo, hi] = std::minmax({z[0], z[1], z[2]});
  if (!(lo < hair && hi >= hair)) return false;
  std::array<Point, 2> crossing;
  size_t n = 0;
  for (size_t k = 0; k < 3 && n < 2; ++k) {
    const size_t j = (k + 1) % 3;
    if ((z[k] < hair) == (z[j] < hair)) continue;
    crossing[n++] = corners[k] + (corners[j] - corners[k]) * ((hair - z[k]) / (z[j] - z[k]));
  }
  const Point area = cross(corners[1] - corners[0], corners[2] - corners[0]);
  const Point m = area * (1 / length(area));
  const Point down = m * dot(m, plane.normal) - plane.normal;  // along the triangle; its length is the slope's sine
  const double sine2 = dot(down, down), foot = std::max(0.0, lo);
  if (!(sine2 > 1e-12)) return false;
  const Point run = down * ((hair - foot) / sine2);
  fence->above = {crossing[0] - plane.normal * hair, crossing[1] - plane.normal * hair};
  fence->foot = {crossing[0] + run - plane.normal * foot, crossing[1] + run - plane.normal * foot};
  return true;
}

// An edge of a triangle that hangs over a surface, as far as it hangs lower than `low`. Where triangles lie on both sides of it, it bounds nothing.
struct HangingEdge {
  std::array<Point, 2> corners;      // of the triangle, in the order of their coordinates
  bool left = false, right = false;  // of it the triangle lies, seen from above; neither: the triangle stands on end
  Segment line;                      // in the surface's plane
  bool sharesCorners(const HangingEdge& e) const { return key() == e.key(); }
  std::array<double, 6> key() const { return {corners[0].x, corners[0].y, corners[0].z, corners[1].x, corners[1].y, corners[1].z}; }
};

void addEdges(const Plane& plane, const std::array<Point, 3>& corners, double low, std::vector<HangingEdge>& edges) {
  std::array<double, 3> z;
  for (size_t k = 0; k < 3; ++k) z[k] = plane.above(corners[k]) - low;
  const auto onPlane = [&](const Point& p) { return p - plane.normal * plane.above(p); };
  std::array<Point, 2> crossing;
  size_t crossings = 0;
  for (size_t k = 0; k < 3; ++k) {
    size_t i = k, j = (k + 1) % 3;
    if (std::tuple(corners[j].x, corners[j].y, corners[j].z) < std::tuple(corners[i].x, corners[i].y, corners[i].z)) std::swap(i, j);
    if (z[i] >= 0 && z[j] >= 0) continue;
    HangingEdge edge{{corners[i], corners[j]}, false, false, {corners[i], corners[j]}};
    if (z[i] >= 0 || z[j] >= 0) {
      const Point c = corners[i] + (corners[j] - corners[i]) * (z[i] / (z[i] - z[j]));
      (z[i] >= 0 ? edge.line.a : edge.line.b) = c;
      if (crossings < 2) crossing[crossings++] = c;
    }
    edge.line = {onPlane(edge.line.a), onPlane(edge.line.b)};
    const Point along = onPlane(corners[j]) - onPlane(corners[i]), to = onPlane(corners[(k + 2) % 3]) - onPlane(corners[i]);
    const double aside = dot(cross(along, to), plane.normal), level = 1e-6 * length(along) * length(to);
    edge.left = aside > level;
    edge.right = aside < -level;
    edges.push_back(edge);
  }
  if (crossings == 2) edges.push_back({crossing, false, false, {onPlane(crossing[0]), onPlane(crossing[1])}});
}

// Leaves out those inside of what hangs there.
void keepOutline(std::vector<HangingEdge>& edges) {
  std::ranges::sort(edges, {}, &HangingEdge::key);
  size_t kept = 0;
  for (size_t k = 0, end = 0; k < edges.size(); k = end) {
    bool left = false, right = false;
    for (end = k; end < edges.size() && edges[end].sharesCorners(edges[k]); ++end) {
      left |= edges[end].left;
      right |= edges[end].right;
    }
    if (!left || !right) edges[kept++] = edges[k];
  }
  edges.resize(kept);
}

// Only what reaches from border to border, or is part of a ring, parts a polygon: whatever has fewer than two contacts goes,
// and so does what it held.
void dropDangling(PolygonView polygon, double gap, std::vector<Segment>& fences) {
  const size_t n = fences.size();
  std::vector<std::vector<uint32_t>> touching(n);
  std::vector<size_t> contacts(n, 0);
  std::vector<Extent> around;
  for (const Segment& s : fences) around.push_back(extentOf(std::array{s.a, s.b}));
  for (uint32_t i = 0; i < n; ++i) {
    for (const Point& end : {fences[i].a, fences[i].b})
      for (size_t k = 0; k < polygon.size(); ++k)
        if (distance(end, Segment{polygon[k], polygon[(k + 1) % polygon.size()]}) <= gap) {
          ++contacts[i];
          break;
        }
    for (uint32_t j = 0; j < i; ++j)
      if (!areApart(around[i], around[j], gap) && distance(fences[i], fences[j]) <= gap) {
        touching[i].push_back(j);
        touching[j].push_back(i);
      }
  }
  for (uint32_t i = 0; i < n; ++i) contacts[i] += touching[i].size();
  std::vector<uint32_t> loose;
  std::vector<bool> gone(n, false);
  for (uint32_t i = 0; i < n; ++i)
    if (contacts[i] < 2) loose.push_back(i);
  while (!loose.empty()) {
    const uint32_t i = loose.back();
    loose.pop_back();
    if (gone[i]) continue;
    gone[i] = true;
    for (const uint32_t j : touching[i])
      if (!gone[j] && --contacts[j] < 2) loose.push_back(j);
  }
  size_t kept = 0;
  for (size_t i = 0; i < n; ++i)
    if (!gone[i]) fences[kept++] = fences[i];
  fences.resize(kept);
}

// A binary space partition: convex polygons, each a leaf or cut into two.
struct PolygonPart {
  Polygon polygon;
  uint32_t cut = 0;  // number of the first of its two parts; 0: a leaf
};

// Whether a fence lies right across a polygon, but for eps at its ends: it parts even what is narrower than eps there.
bool liesAcross(PolygonView polygon, Point normal, double eps, const Segment& fence) {
  constexpr double kShortest = 1e-9;  // cells: nearer to a corner there is nothing to part
  const double l = length(fence.b - fence.a);
  if (!(l > kShortest)) return false;
  const Point along = (fence.b - fence.a) * (1 / l);
  Segment reached{fence.a - along * eps, fence.b + along * eps}, chord{fence.a - along, fence.b + along};
  if (!clipInside(polygon, normal, 0, reached) || !clipInside(polygon, normal, 0, chord)) return false;
  const double across = length(chord.b - chord.a);
  return across > kShortest && length(reached.b - reached.a) > 0.999 * across;
}

void cutAlong(const Segment& fence, Point normal, double eps, std::vector<PolygonPart>& parts) {
  const Point along = fence.b - fence.a;
  const Point across = cross(normal, along) * (1 / length(along));
  const double offset = dot(across, fence.a);
  const auto side = [&](const Point& p) { return dot(across, p) - offset; };
  const auto crossing = [&](const Point& lo, const Point& hi) { return lo + (hi - lo) * (side(lo) / (side(lo) - side(hi))); };
  const size_t before = parts.size();
  Polygon below, above;
  for (size_t i = 0; i < before && parts.size() + 2 <= 2 * kMaxParts; ++i) {
    if (parts[i].cut) continue;
    Segment inside = fence;
    const bool reaches_in = clipInside(parts[i].polygon, normal, eps, inside) && length(inside.b - inside.a) > eps;
    if (!reaches_in && !liesAcross(parts[i].polygon, normal, eps, fence)) continue;
    split(parts[i].polygon, side, crossing, eps, below, above);
    if (below.size() < 3 || above.size() < 3) continue;
    parts[i].cut = static_cast<uint32_t>(parts.size());
    parts.push_back({below});
    parts.push_back({above});
  }
}

}  // namespace

struct Fences::Found {
  std::vector<Segment> fences;  // that may part it, the longest first; both sides'
  bool fenced[2] = {}, close[2] = {}, low[2] = {}, doubled[2] = {};  // close: something may lie on it; low: or hang low over it; doubled: or stand for it
};

Vec3 Fences::metres(Point p) const { return vec3Of(p * cell_m_); }

std::array<Point, 3> Fences::cornersOf(uint32_t triangle) const {
  std::array<Point, 3> corners;
  for (size_t k = 0; k < 3; ++k) corners[k] = pointOf(scene_.positions[scene_.triangles[triangle].v[k]]) / cell_m_;
  return corners;
}

double Fences::hairOf(uint32_t triangle) const {
  return std::max(kHairCells, 4 * static_cast<double>(caster_.surfaceOffset(triangle)) / cell_m_);
}

double Fences::lowOf(uint32_t triangle) const { return std::max(kLowCells, hairOf(triangle)); }

double Fences::touchOf(uint32_t triangle) const { return 0.1 * static_cast<double>(caster_.surfaceOffset(triangle)) / cell_m_; }

Point Fences::normalOf(uint32_t triangle) const {
  const auto [a, b, c] = cornersOf(triangle);
  const Point n = cross(b - a, c - a);
  const double l = length(n);
  return l > 0 ? n * (1 / l) : Point{0, 1, 0};
}

bool Fences::inOnePlane(uint32_t t, uint32_t u) const {
  const double touch = std::max(touchOf(t), touchOf(u));
  const auto near = [&](uint32_t plane_of, uint32_t of) {
    const Plane plane{cornersOf(plane_of)[0], normalOf(plane_of)};
    return std::ranges::all_of(cornersOf(of), [&](const Point& p) { return std::abs(plane.above(p)) <= touch; });
  };
  return near(t, u) && near(u, t);
}

bool Fences::comesFirst(uint32_t t, uint32_t u) const {
  const auto isLamp = [&](uint32_t v) { return !(scene_.materials[scene_.triangles[v].material].emission == Vec3{}); };
  return isLamp(t) != isLamp(u) ? isLamp(t) : t < u;
}

bool Fences::standsFor(uint32_t other, uint32_t triangle, bool back) const {
  const Material& material = scene_.materials[scene_.triangles[other].material];
  if (material.cutout || patchedSides(material) == 0 || !comesFirst(other, triangle)) return false;
  return material.double_sided || (dot(normalOf(other), normalOf(triangle)) < 0) == back;
}

Fences::Double Fences::doubleOf(uint32_t triangle, bool back, Point point) const {
  const double hair = hairOf(triangle);
  std::vector<uint32_t> near;
  caster_.near(metres(point), static_cast<float>(hair * cell_m_), near);
  uint32_t first = triangle;
  for (const uint32_t u : near)
    if (u != triangle && comesFirst(u, first) && standsFor(u, triangle, back) && inOnePlane(u, triangle) && contains(cornersOf(u), point, hair)) first = u;
  if (first == triangle) return {};
  return {first, (dot(normalOf(first), normalOf(triangle)) < 0) == back};
}

Fences::Found Fences::find(const Piece& piece) const {
  Found found;
  const Point normal = normalOf(piece.triangle);
  const double hair = hairOf(piece.triangle), touch = touchOf(piece.triangle);
  Point lo = piece.polygon[0], hi = lo;
  for (const Point& p : piece.polygon)
    for (int a = 0; a < 3; ++a) {
      lo[a] = std::min(lo[a], p[a]);
      hi[a] = std::max(hi[a], p[a]);
    }
  const bool is_large = length(vectorArea(piece.polygon)) >= kLeastUnder;
  const double low = lowOf(piece.triangle), radius = length(hi - lo) / 2 + (is_large ? std::max(low, 2 * hair) : 2 * hair), eps = kHairsOffBorder * hair;
  const int sides = patchedSides(scene_.materials[scene_.triangles[piece.triangle].material]);
  std::vector<uint32_t> near;
  std::array<std::vector<HangingEdge>, 2> hanging;
  caster_.near(metres((lo + hi) * 0.5), static_cast<float>(radius * cell_m_), near);
  for (const uint32_t u : near) {
    if (u == piece.triangle) continue;
    const auto corners = cornersOf(u);
    for (int side = 0; side < sides; ++side) {
      const Plane plane{piece.polygon[0], side == 0 ? normal : normal * -1};
      Fence fence;
      if (fenceOf(plane, corners, hair, &fence)) {
        // What leans away from it does not stand on it: the other side of a fold.
        if (!clipInside(piece.polygon, normal, -eps, fence.above)) continue;
        found.fenced[side] = true;
        const bool across = liesAcross(piece.polygon, normal, eps, fence.foot);
        if (clipInside(piece.polygon, normal, 0, fence.foot) && (across || length(fence.foot.b - fence.foot.a) > eps))
          found.fences.push_back(fence.foot);
        continue;
      }
      const std::array<double, 3> z{plane.above(corners[0]), plane.above(corners[1]), plane.above(corners[2])};
      const auto [least, most] = std::minmax({z[0], z[1], z[2]});
      const auto addInside = [&] {
        for (size_t k = 0; k < 3; ++k) {
          Segment edge{corners[k] - plane.normal * z[k], corners[(k + 1) % 3] - plane.normal * z[(k + 1) % 3]};
          Segment inside = edge;
          if (clipInside(piece.polygon, normal, eps, inside) && clipInside(piece.polygon, normal, 0, edge) && length(edge.b - edge.a) > eps)
            found.fences.push_back(edge);
        }
      };
      if (const double either = std::max(touch, touchOf(u)); most <= either && least >= -either && inOnePlane(u, piece.triangle)) {
        if (!standsFor(u, piece.triangle, side == 1)) continue;
        found.doubled[side] = true;
        addInside();
        continue;
      }
      if (is_large && least >= hair && least < low) {
        found.low[side] = true;
        addEdges(plane, corners, low, hanging[static_cast<size_t>(side)]);
        continue;
      }
      if (!(most < hair && most > touch && least > -touch)) continue;
      found.close[side] = true;
      addInside();
    }
  }
  const auto sortLongestFirst = [](std::span<Segment> some) {
    std::sort(some.begin(), some.end(), [](const Segment& s, const Segment& t) {
      const auto key = [](const Segment& x) { return std::tuple(-length(x.b - x.a), x.a.x, x.a.y, x.a.z, x.b.x, x.b.y, x.b.z); };
      return key(s) < key(t);
    });
  };
  sortLongestFirst(found.fences);
  const size_t standing = found.fences.size();
  for (size_t side = 0; side < 2; ++side) {
    keepOutline(hanging[side]);
    for (const HangingEdge& edge : hanging[side]) {
      Segment reached = edge.line, line = edge.line;
      if (!(length(line.b - line.a) > eps) || !clipInside(piece.polygon, normal, -eps, reached)) continue;
      found.fenced[side] = true;
      Segment inside = line;
      if (clipInside(piece.polygon, normal, eps, inside) && clipInside(piece.polygon, normal, 0, line) && length(line.b - line.a) > eps) found.fences.push_back(line);
    }
  }
  sortLongestFirst(std::span(found.fences).subspan(standing));
  if (found.fences.size() > kMaxFences) found.fences.resize(kMaxFences);
  dropDangling(piece.polygon, 2 * hair, found.fences);
  return found;
}

void Fences::cut(const Piece& whole, PieceList& out) const {
  const Found found = find(whole);
  Piece piece = whole;
  std::copy_n(found.fenced, 2, piece.fenced);
  std::copy_n(found.low, 2, piece.low);
  std::vector<PolygonPart> parts{{Polygon(piece.polygon.begin(), piece.polygon.end())}};
  if (!found.fences.empty()) {
    const Point normal = normalOf(piece.triangle);
    for (const Segment& fence : found.fences) cutAlong(fence, normal, kHairsOffBorder * hairOf(piece.triangle), parts);
  }
  std::vector<Piece> leaves;
  std::vector<uint32_t> leaf_of(parts.size(), 0);
  for (size_t i = 0; i < parts.size(); ++i) {
    if (parts[i].cut) continue;
    leaf_of[i] = static_cast<uint32_t>(leaves.size());
    Piece leaf = piece;
    leaf.polygon = parts[i].polygon;
    for (int side = 0; side < 2; ++side) {
      const Point at = middle(leaf.polygon);
      leaf.doubled[side] = found.doubled[side] && doubleOf(piece.triangle, side == 1, at).triangle != kNone;
      leaf.covered[side] = leaf.doubled[side] || (found.close[side] && isCovered(piece.triangle, side == 1, at)) || (found.low[side] && isUnder(piece.triangle, side == 1, at));
    }
    leaves.push_back(std::move(leaf));
  }
  // Parts that belong together on both sides are one again where they came from one cut.
  const int sides = patchedSides(scene_.materials[scene_.triangles[piece.triangle].material]);
  std::array<UnionFind, 2> sets{UnionFind(leaves.size()), UnionFind(leaves.size())};
  for (int side = 0; side < sides; ++side) {
    auto& set = sets[static_cast<size_t>(side)];
    for (uint32_t i = 0; i < leaves.size(); ++i)
      for (uint32_t j = 0; j < i; ++j)
        if (set.find(i) != set.find(j) && between({&leaves[i], side == 1}, {&leaves[j], side == 1}) == Border::kOpen) set.join(i, j);
  }
  const auto label = [&](uint32_t leaf) { return std::pair(sets[0].find(leaf), sets[1].find(leaf)); };
  for (size_t i = parts.size(); i-- > 0;) {
    const uint32_t first = parts[i].cut;
    if (!first || parts[first].cut || parts[first + 1].cut || label(leaf_of[first]) != label(leaf_of[first + 1])) continue;
    leaf_of[i] = leaf_of[first];
    parts[i].cut = 0;
    parts[first].polygon.clear();
    parts[first + 1].polygon.clear();
  }
  for (size_t i = 0; i < parts.size(); ++i) {
    if (parts[i].cut || parts[i].polygon.empty()) continue;
    Piece part = leaves[leaf_of[i]];
    part.polygon = parts[i].polygon;
    out.add(part);
  }
}

Fences::Border Fences::between(PieceSide a, PieceSide b) const {
  Border border = Border::kApart;
  for (const SharedBorder& shared : sharedBorders(a.piece->polygon, b.piece->polygon, kBorderCells)) {
    if (isOpen(a, b, shared)) return Border::kOpen;
    border = Border::kClosed;
  }
  return border;
}

bool Fences::isOpen(PieceSide a, PieceSide b, const SharedBorder& shared) const {
  if (a.piece->covered[a.back] != b.piece->covered[b.back] || a.piece->doubled[a.back] != b.piece->doubled[b.back]) return false;
  if (!a.piece->fenced[a.back] && !b.piece->fenced[b.back]) return true;
  // Where an eye a hair above the surface is, half a hair inside of a side of a polygon.
  struct Rim {
    Point at, along, lift;
    Point eye(Point p) const { return at + along * dot(p - at, along) + lift; }
  };
  const double hair = std::max(hairOf(a.piece->triangle), hairOf(b.piece->triangle));
  const auto rim = [&](PieceSide s, size_t side, double height) {
    const PolygonView p = s.piece->polygon;
    const Point normal = normalOf(s.piece->triangle), edge = p[(side + 1) % p.size()] - p[side];
    const Point along = edge * (1 / length(edge));
    return Rim{p[side], along, cross(normal, along) * (hair / 2) + normal * (s.back ? -height : height)};
  };
  const Point edge = shared.line.b - shared.line.a;
  const double l = length(edge);
  const auto seesAcross = [&](double height) {
    const Rim of_a = rim(a, shared.side_p, height), of_b = rim(b, shared.side_q, height);
    const auto seen = [&](double at) {
      const Point p = shared.line.a + edge * std::clamp(at, 0.0, 1.0);
      return isClear(metres(of_a.eye(p)), metres(of_b.eye(p)));
    };
    for (int k = 0; k < kLooks; ++k) {
      const double at = (k + 0.5) / kLooks;
      if (seen(at) && seen(at - hair / l) && seen(at + hair / l)) return true;  // and not through a slit
    }
    return false;
  };
  if (!seesAcross(hair)) return false;
  if (a.piece->covered[a.back] || !(a.piece->low[a.back] || b.piece->low[b.back])) return true;
  return seesAcross(std::max(lowOf(a.piece->triangle), lowOf(b.piece->triangle)));
}

bool Fences::isClear(Vec3 from, Vec3 to) const {
  const float way = ff::length(to - from);
  return !(way > 0) || !caster_.occluded({from, (to - from) / way}, way);
}

bool Fences::sees(PieceSide a, PieceSide b) const {
  const auto eye = [&](PieceSide s) {
    const uint32_t t = s.piece->triangle;
    return middle(s.piece->polygon) + normalOf(t) * (s.back ? -hairOf(t) : hairOf(t));
  };
  const Point from_cells = eye(a), to_cells = eye(b);
  if (hides(a, from_cells, to_cells) || (scene_.backs != Backs::kPass && hides(b, to_cells, from_cells))) return false;
  return isClear(metres(from_cells), metres(to_cells));
}

bool Fences::shareSpace(PieceSide a, PieceSide b) const {
  const auto away = [&](PieceSide s) {
    const uint32_t t = s.piece->triangle;
    const Point up = normalOf(t) * (s.back ? -1.0 : 1.0);
    const Vec3 from = metres(middle(s.piece->polygon) + up * hairOf(t)), along = vec3Of(up);
    const float most = static_cast<float>(2 * kAwayCells * edgeCells(s.piece->fineness) * cell_m_);
    const Hit hit = caster_.nearest({from, along}, most);
    return from + along * (0.5f * (hit.triangle == kNone ? most : std::min(most, ff::length(hit.point - from))));
  };
  return isClear(away(a), away(b));
}

// Whether a piece itself is in the way from the eye a hair above its middle to another point: where that is clear, no ray need be cast. Rounding to single
// precision stays well within the margin, as a hair is hundreds of its steps.
bool Fences::hides(PieceSide of, const Point& eye, const Point& to) const {
  const Piece& piece = *of.piece;
  if (scene_.materials[scene_.triangles[piece.triangle].material].cutout) return false;
  const Point normal = normalOf(piece.triangle), up = normal * (of.back ? -1.0 : 1.0), way = to - eye;
  const double hair = hairOf(piece.triangle), down = -dot(up, way);
  if (!(down > 2 * hair)) return false;
  const Point foot = way + up * down, crossing = eye - up * hair + foot * (hair / down);
  const double margin = 0.05 * length(foot) * (hair / down) + 0.1 * hair;
  for (size_t i = 0; i < piece.polygon.size(); ++i) {
    const Point side = piece.polygon[(i + 1) % piece.polygon.size()] - piece.polygon[i];
    if (dot(cross(normal, side), crossing - piece.polygon[i]) < margin * length(side)) return false;
  }
  return true;
}

bool Fences::isUnder(uint32_t triangle, bool back, Point point) const {
  const Point up = normalOf(triangle) * (back ? -1.0 : 1.0);
  const double hair = hairOf(triangle);
  return caster_.occluded({metres(point + up * hair), vec3Of(up)}, static_cast<float>((lowOf(triangle) - hair) * cell_m_));
}

bool Fences::isCovered(uint32_t triangle, bool back, Point point) const {
  const Point normal = normalOf(triangle) * (back ? -1.0 : 1.0);
  const Vec3 down{static_cast<float>(-normal.x), static_cast<float>(-normal.y), static_cast<float>(-normal.z)};
  const double hair = hairOf(triangle), touch = touchOf(triangle);
  const Hit hit = caster_.nearest({metres(point + normal * hair), down}, static_cast<float>((hair - touch) * cell_m_));
  return hit.triangle != kNone && hit.triangle != triangle && !inOnePlane(hit.triangle, triangle) &&
         (hit.front || scene_.materials[scene_.triangles[hit.triangle].material].double_sided);
}

}  // namespace ff::bake
