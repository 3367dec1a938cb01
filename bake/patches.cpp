#include "bake/patches.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <span>
#include <tuple>

#include "bake/pieces.h"
#include "bake/surface_sampling.h"

namespace ff::bake {
namespace {

uint32_t orientationOf(const Point& n) {
  const double ax = std::abs(n.x), ay = std::abs(n.y), az = std::abs(n.z);
  const double slack = 1e-6 * (ax + ay + az);  // diagonal surfaces: rounding must not choose
  const int a = ay >= ax - slack && ay >= az - slack ? 1 : ax >= az - slack ? 0 : 2;
  return static_cast<uint32_t>(2 * a + (n[a] < 0));
}

double distanceToSegment(const Point& p, const Point& a, const Point& b) {
  const Point ab = b - a, ap = p - a;
  const double l = dot(ab, ab);
  const double t = l > 0 ? std::clamp(dot(ap, ab) / l, 0.0, 1.0) : 0;
  const Point d{ap.x - t * ab.x, ap.y - t * ab.y, ap.z - t * ab.z};
  return std::sqrt(dot(d, d));
}

bool cornerOnBorder(const Polygon& p, const Polygon& q, double tolerance) {
  for (const Point& v : p)
    for (size_t i = 0; i < q.size(); ++i)
      if (distanceToSegment(v, q[i], q[(i + 1) % q.size()]) < tolerance) return true;
  return false;
}

struct UnionFind {
  std::vector<uint32_t> parent;
  explicit UnionFind(size_t n) : parent(n) { std::iota(parent.begin(), parent.end(), 0u); }
  uint32_t find(uint32_t i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  }
  void join(uint32_t a, uint32_t b) {
    a = find(a);
    b = find(b);
    if (a != b) parent[std::max(a, b)] = std::min(a, b);  // the root is the first piece
  }
};

constexpr double kTouch = 2e-3;  // cells

// Labels the pieces of one cell, orientation and lamp group: pieces that share a corner, or one of whose corners lies on another's
// border (T-junctions), get one label.
UnionFind connect(const std::vector<const Polygon*>& pieces, const std::vector<Cell>& cells) {
  UnionFind sets(pieces.size());
  if (pieces.size() == 1) return sets;
  std::vector<std::pair<std::array<int32_t, 3>, uint32_t>> corners;
  for (uint32_t i = 0; i < pieces.size(); ++i)
    for (const Point& p : *pieces[i]) {
      std::array<int32_t, 3> q;
      for (int a = 0; a < 3; ++a) q[a] = static_cast<int32_t>(std::lround((p[a] - cells[i][a]) * 512));
      corners.emplace_back(q, i);
    }
  std::sort(corners.begin(), corners.end());
  for (size_t k = 1; k < corners.size(); ++k)
    if (corners[k].first == corners[k - 1].first) sets.join(corners[k].second, corners[k - 1].second);
  constexpr size_t kMostPairs = 400;  // past this the cell is crowded, and crumbs are joined by nearness anyway
  if (pieces.size() <= kMostPairs)
    for (uint32_t i = 0; i < pieces.size(); ++i)
      for (uint32_t j = i + 1; j < pieces.size(); ++j)
        if (sets.find(i) != sets.find(j) &&
            (cornerOnBorder(*pieces[i], *pieces[j], kTouch) || cornerOnBorder(*pieces[j], *pieces[i], kTouch)))
          sets.join(i, j);
  return sets;
}

}  // namespace

class PatchBuilder {
 public:
  PatchBuilder(const Scene& scene, const PatchSettings& settings, const RayCaster* caster)
      : scene_(scene), settings_(settings), caster_(caster), lamps_(groupLamps(scene)) {}

  Result<PatchSet> build() {
    const float s = settings_.cell_m;
    if (!(s > 0) || !std::isfinite(s))
      return Error{ErrorCode::kUsage, scene_.name, "", "patch size must be positive", "give --patch-size in metres"};
    float largest = 0;
    for (const Vec3& p : scene_.positions)
      for (int a = 0; a < 3; ++a) largest = std::max(largest, std::abs(p[a]));
    if (largest / s >= static_cast<float>(kCellBias - 2))
      return Error{ErrorCode::kUsage, scene_.name, "", "the scene spans more than 2^20 cells from the origin",
                   "use a larger --patch-size"};
    if (auto cut = cutTriangles(); !cut) return cut.error();
    makeSides();
    if (sides_.empty()) {  // all is smaller than a cell: better coarse than not at all
      for (Piece& piece : pieces_) piece.enclosure[0] = piece.enclosure[1] = Enclosure::kCrevice;
      makeSides();
    }
    formPatches();
    measure();
    return std::move(set_);
  }

 private:
  struct Side {
    uint64_t key;
    uint32_t orientation;
    uint32_t piece;
    uint32_t back;  // 1: the back of a double-sided piece
    uint16_t lamp_group;
    Enclosure enclosure;
    // What emits nothing comes first.
    auto place() const { return std::tuple(key, orientation, static_cast<uint16_t>(lamp_group + 1)); }
    // Sides of one group may share a patch.
    auto group() const { return std::tuple_cat(place(), std::tuple(enclosure)); }
    friend bool operator<(const Side& a, const Side& b) {
      return std::tuple_cat(a.group(), std::tuple(a.piece, a.back)) < std::tuple_cat(b.group(), std::tuple(b.piece, b.back));
    }
  };

  Result<void> cutTriangles() {
    constexpr size_t kChunk = 1024;
    const size_t n = scene_.triangles.size(), chunks = (n + kChunk - 1) / kChunk;
    // An upper bound of the pieces, so that a tiny patch size ends in a message and not in swapping.
    double bound = 0;
    const double s = static_cast<double>(settings_.cell_m);
    for (uint32_t t = 0; t < n; ++t) bound += 1 + static_cast<double>(triangleArea(scene_, t)) / (s * s);
    if (bound > 5e8)
      return Error{ErrorCode::kUsage, scene_.name, "",
                   "this patch size would make about " + std::to_string(static_cast<uint64_t>(bound)) + " pieces",
                   "use a larger --patch-size"};
    const PieceCutter cutter(scene_, settings_.cell_m, caster_);
    std::vector<std::vector<Piece>> parts(chunks);
    tbb::parallel_for(size_t{0}, chunks, [&](size_t c) {
      for (size_t t = c * kChunk; t < std::min(n, (c + 1) * kChunk); ++t) cutter.cut(static_cast<uint32_t>(t), parts[c]);
    });
    set_.piece_start_.assign(n + 1, 0);
    for (auto& part : parts) {
      for (Piece& p : part) {
        ++set_.piece_start_[p.triangle + 1];
        pieces_.push_back(std::move(p));
      }
      part = {};
    }
    for (size_t t = 0; t < n; ++t) set_.piece_start_[t + 1] += set_.piece_start_[t];
    if (pieces_.empty())
      return Error{ErrorCode::kInvalidFile, scene_.name, "", "no surface with an area", "export the meshes' triangles"};
    return {};
  }

  void makeSides() {
    for (uint32_t i = 0; i < pieces_.size(); ++i) {
      const uint64_t key = hilbertKey(pieces_[i].cell);
      const uint32_t o = orientationOf(vectorArea(pieces_[i].polygon));
      const Material& material = scene_.materials[scene_.triangles[pieces_[i].triangle].material];
      const uint16_t lamp_group = lamps_.of_material[scene_.triangles[pieces_[i].triangle].material];
      for (uint32_t back = 0; back < (material.double_sided ? 2 : 1); ++back)
        if (pieces_[i].enclosure[back] != Enclosure::kPocket)
          sides_.push_back({key, o ^ back, i, back, lamp_group, pieces_[i].enclosure[back]});
    }
    tbb::parallel_sort(sides_.begin(), sides_.end());
    for (size_t begin = 0, end; begin < sides_.size(); begin = end) {
      end = begin + 1;
      while (end < sides_.size() && sides_[end].place() == sides_[begin].place()) ++end;
      joinRare(std::span(sides_).subspan(begin, end - begin));
    }
  }

  // A little open surface among much that is not, or the reverse, is not worth a patch of its own.
  void joinRare(std::span<Side> sides) const {
    double area[2] = {0, 0};
    for (const Side& side : sides) {
      const Point n = vectorArea(pieces_[side.piece].polygon);
      area[side.enclosure == Enclosure::kCrevice] += std::sqrt(dot(n, n));
    }
    const bool rare = area[1] < area[0];
    if (area[rare] == 0 || area[rare] >= static_cast<double>(settings_.crumb_fraction) * (area[0] + area[1])) return;
    for (Side& side : sides) side.enclosure = rare ? Enclosure::kOpen : Enclosure::kCrevice;
    std::sort(sides.begin(), sides.end());
  }

  // Gives every side its patch: labels_ is parallel to sides_.
  void formPatches() {
    std::vector<size_t> group_start;
    for (size_t i = 0; i < sides_.size(); ++i)
      if (i == 0 || sides_[i].group() != sides_[i - 1].group()) group_start.push_back(i);
    group_start.push_back(sides_.size());
    const size_t groups = group_start.size() - 1;
    labels_.resize(sides_.size());  // within the group first
    std::vector<uint32_t> count(groups);
    tbb::parallel_for(size_t{0}, groups,
                      [&](size_t g) { count[g] = labelGroup(group_start[g], group_start[g + 1]); });
    uint32_t patches = 0;
    for (size_t g = 0; g < groups; ++g) {
      for (size_t i = group_start[g]; i < group_start[g + 1]; ++i) labels_[i] += patches;
      patches += count[g];
    }
    set_.patches.resize(patches);
  }

  uint32_t labelGroup(size_t begin, size_t end) {
    std::vector<const Polygon*> polygons;
    std::vector<Cell> cells;
    for (size_t i = begin; i < end; ++i) {
      polygons.push_back(&pieces_[sides_[i].piece].polygon);
      cells.push_back(pieces_[sides_[i].piece].cell);
    }
    UnionFind sets = connect(polygons, cells);
    struct Component {
      double area = 0;
      Point moment{0, 0, 0};
      uint32_t label = 0;
    };
    std::vector<Component> components(polygons.size());
    for (uint32_t i = 0; i < polygons.size(); ++i) {
      Component& c = components[sets.find(i)];
      const Point n = vectorArea(*polygons[i]);
      const double area = std::sqrt(dot(n, n));
      Point mid{0, 0, 0};
      for (const Point& p : *polygons[i]) mid = {mid.x + p.x, mid.y + p.y, mid.z + p.z};
      const double w = area / static_cast<double>(polygons[i]->size());
      c.area += area;
      c.moment = {c.moment.x + w * mid.x, c.moment.y + w * mid.y, c.moment.z + w * mid.z};
    }
    const auto centre = [&](const Component& c) {
      const double a = std::max(c.area, 1e-30);
      return Point{c.moment.x / a, c.moment.y / a, c.moment.z / a};
    };
    std::vector<uint32_t> whole;  // components that are patches of their own
    for (uint32_t i = 0; i < components.size(); ++i)
      if (sets.find(i) == i && components[i].area >= static_cast<double>(settings_.crumb_fraction)) whole.push_back(i);
    if (whole.empty()) {  // crumbs only: one patch together
      for (size_t i = begin; i < end; ++i) labels_[i] = 0;
      return 1;
    }
    for (uint32_t k = 0; k < whole.size(); ++k) components[whole[k]].label = k;
    for (uint32_t i = 0; i < components.size(); ++i) {
      if (sets.find(i) != i || components[i].area >= static_cast<double>(settings_.crumb_fraction)) continue;
      double best = 1e300;
      for (uint32_t w : whole) {
        const Point d = centre(components[i]) - centre(components[w]);
        if (dot(d, d) < best) {
          best = dot(d, d);
          components[i].label = components[w].label;
        }
      }
    }
    for (size_t i = begin; i < end; ++i) labels_[i] = components[sets.find(static_cast<uint32_t>(i - begin))].label;
    return static_cast<uint32_t>(whole.size());
  }

  // Triangulates the pieces by patch and averages what a patch carries.
  void measure() {
    set_.cell_m = settings_.cell_m;
    set_.pieces_.resize(pieces_.size());
    for (size_t i = 0; i < pieces_.size(); ++i) {
      set_.pieces_[i] = {static_cast<uint32_t>(pieces_[i].depth), pieces_[i].cube};
      const Point n = vectorArea(pieces_[i].polygon);
      for (int side = 0; side < 2; ++side)
        if (pieces_[i].enclosure[side] == Enclosure::kPocket) {
          set_.pieces_[i].patch[side] = kSealed;
          set_.sealed_m2 += std::sqrt(dot(n, n)) * static_cast<double>(settings_.cell_m) * static_cast<double>(settings_.cell_m);
        }
    }
    std::vector<uint32_t> order(sides_.size());
    std::iota(order.begin(), order.end(), 0u);
    std::stable_sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return labels_[a] < labels_[b]; });
    std::vector<uint32_t> start(set_.patches.size() + 1, 0);  // into order
    for (uint32_t l : labels_) ++start[l + 1];
    for (size_t p = 0; p < set_.patches.size(); ++p) start[p + 1] += start[p];
    uint32_t triangles = 0;
    for (uint32_t p = 0; p < set_.patches.size(); ++p) {
      Patch& patch = set_.patches[p];
      patch.first_triangle = triangles;
      for (uint32_t k = start[p]; k < start[p + 1]; ++k) {
        const Side& side = sides_[order[k]];
        triangles += static_cast<uint32_t>(pieces_[side.piece].polygon.size()) - 2;
        set_.pieces_[side.piece].patch[side.back] = p;
        patch.cell = pieces_[side.piece].cell;
        patch.key = side.key;
        patch.orientation = side.orientation;
        patch.lamp_group = side.lamp_group;
        patch.enclosure = side.enclosure;
      }
      patch.triangles = triangles - patch.first_triangle;
    }
    set_.triangles.resize(triangles);
    tbb::parallel_for(size_t{0}, set_.patches.size(), [&](size_t p) { measurePatch(p, order, start); });
    for (const Patch& p : set_.patches) set_.area_m2 += static_cast<double>(p.area_m2);
  }

  void measurePatch(size_t p, const std::vector<uint32_t>& order, const std::vector<uint32_t>& start) {
    Patch& patch = set_.patches[p];
    uint32_t at = patch.first_triangle;
    double area = 0, solid = 0;
    SurfaceMean mean(settings_.metals);
    Point centre{0, 0, 0};
    Vec3 normal;
    const float s = settings_.cell_m;
    for (uint32_t k = start[p]; k < start[p + 1]; ++k) {
      const Side& side = sides_[order[k]];
      const Piece& piece = pieces_[side.piece];
      const auto metres = [&](size_t i) {
        const Point& c = piece.polygon[i];
        return Vec3{static_cast<float>(c.x * static_cast<double>(s)), static_cast<float>(c.y * static_cast<double>(s)),
                    static_cast<float>(c.z * static_cast<double>(s))};
      };
      for (size_t i = 1; i + 1 < piece.polygon.size(); ++i) {
        PatchTriangle& t = set_.triangles[at++];
        t.a = metres(0);
        t.b = metres(side.back ? i + 1 : i);
        t.c = metres(side.back ? i : i + 1);
        t.source = piece.triangle;
        const Vec3 n = cross(t.b - t.a, t.c - t.a) * 0.5f;
        const float whole = length(n);
        const float opaque = whole * mean.add(scene_, t.source, t.a, t.b, t.c, whole);
        area += static_cast<double>(whole);
        solid += static_cast<double>(opaque);
        t.cumulative_area = static_cast<float>(solid);
        normal += n;
        const Vec3 mid = (t.a + t.b + t.c) / 3.0f;
        centre = {centre.x + static_cast<double>(whole * mid.x), centre.y + static_cast<double>(whole * mid.y),
                  centre.z + static_cast<double>(whole * mid.z)};
        patch.bounds.add(t.a);
        patch.bounds.add(t.b);
        patch.bounds.add(t.c);
      }
    }
    // A patch of holes alone, or one that underflows, keeps a token area: it has a row, and nothing sees it.
    const double least = 1e-8 * static_cast<double>(s) * static_cast<double>(s);
    patch.area_m2 = static_cast<float>(std::max(solid, least));
    area = std::max(area, 1e-300);
    patch.centroid = area > 1e-200 ? Vec3{static_cast<float>(centre.x / area), static_cast<float>(centre.y / area),
                                          static_cast<float>(centre.z / area)}
                                   : set_.triangles[patch.first_triangle].a;
    patch.normal = normalized(normal);
    patch.albedo = mean.albedo();
    patch.emission = mean.emission();
  }

  const Scene& scene_;
  const PatchSettings& settings_;
  const RayCaster* caster_;
  const LampGroups lamps_;
  std::vector<Piece> pieces_;  // by triangle
  std::vector<Side> sides_;
  std::vector<uint32_t> labels_;
  PatchSet set_;
};

Result<PatchSet> makePatches(const Scene& scene, const PatchSettings& settings, const RayCaster* caster) {
  return PatchBuilder(scene, settings, caster).build();
}

uint32_t PatchSet::searchPatch(uint32_t t, bool front, Vec3 p) const {
  const auto first = pieces_.begin() + piece_start_[t], last = pieces_.begin() + piece_start_[t + 1];
  if (first == last) return kNone;
  const auto find = [&](uint32_t depth, const Cell& cube) {
    const auto at = std::lower_bound(first, last, std::tie(depth, cube), [](const CutPiece& q, const auto& key) {
      return std::tie(q.depth, q.cube) < key;
    });
    return at != last && at->depth == depth && at->cube == cube ? at : last;
  };
  const auto cubeOf = [&](uint32_t depth) {
    Cell cube;
    for (int a = 0; a < 3; ++a) cube[a] = static_cast<int32_t>(std::floor(std::ldexp(p[a] / cell_m, static_cast<int>(depth))));
    return cube;
  };
  const uint32_t deepest = (last - 1)->depth;
  for (uint32_t depth = first->depth; depth <= deepest; ++depth)
    if (const auto at = find(depth, cubeOf(depth)); at != last) return at->patch[front ? 0 : 1];
  // On the border of a cube, or in a grid plane: the piece whose cube is nearest.
  auto best = first;
  float nearest = 1e30f;
  const auto consider = [&](auto q) {
    Box box;
    const float edge = std::ldexp(cell_m, -static_cast<int>(q->depth));
    const Vec3 lo{static_cast<float>(q->cube[0]), static_cast<float>(q->cube[1]), static_cast<float>(q->cube[2])};
    box.add(lo * edge);
    box.add((lo + Vec3{1, 1, 1}) * edge);
    if (const float d = box.distance(p); d < nearest) {
      nearest = d;
      best = q;
    }
  };
  if (last - first <= 64) {
    for (auto q = first; q != last; ++q) consider(q);
  } else {
    for (uint32_t depth = first->depth; depth <= deepest; ++depth)
      for (int32_t dx = -1; dx <= 1; ++dx)
        for (int32_t dy = -1; dy <= 1; ++dy)
          for (int32_t dz = -1; dz <= 1; ++dz) {
            const Cell c = cubeOf(depth);
            if (const auto q = find(depth, {c[0] + dx, c[1] + dy, c[2] + dz}); q != last) consider(q);
          }
  }
  return best->patch[front ? 0 : 1];
}

}  // namespace ff::bake
