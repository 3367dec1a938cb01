#include "bake/surface/patches.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <optional>
#include <span>

#include "bake/rays/sobol.h"
#include "bake/rays/surface_sampling.h"
#include "bake/surface/components.h"
#include "bake/surface/fineness.h"
#include "bake/surface/grouped.h"
#include "bake/surface/merging.h"
#include "bake/surface/pieces.h"
#include "bake/surface/sealed.h"

namespace ff::bake {
namespace {

uint32_t orientationOf(const Point& n) {
  const double ax = std::abs(n.x), ay = std::abs(n.y), az = std::abs(n.z);
  const double slack = 1e-6 * (ax + ay + az);  // diagonal surfaces: rounding must not choose
  const int a = ay >= ax - slack && ay >= az - slack ? 1 : ax >= az - slack ? 0 : 2;
  return static_cast<uint32_t>(2 * a + (n[a] < 0));
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
    for (uint32_t t = 0; t < scene_.triangles.size(); ++t) largest = std::max(largest, largestCoordinate(scene_, t));
    if (largest / s >= static_cast<float>(kCellBias - (2 << kMaxFineness)))
      return Error{ErrorCode::kUsage, scene_.name, "", "the scene spans more than 2^20 cells from the origin",
                   "use a larger --patch-size"};
    std::optional<Fences> fences;
    std::optional<SealedSurface> sealed;
    if (caster_) {
      fences.emplace(scene_, s, *caster_);
      sealed.emplace(scene_, s, *caster_, *fences);
    }
    const Fences* parting = fences ? &*fences : nullptr;
    if (auto cut = cutTriangles(PieceCutter(scene_, s, parting)); !cut) return cut.error();
    makeSides();
    if (sides_.empty())
      return Error{ErrorCode::kUsage, scene_.name, "", "no surface has patches: all of it only blocks light", "let some have patches"};
    const double crumb = static_cast<double>(settings_.crumb_fraction);
    labels_ = labelSides(pieces_, sides_, crumb, parting, sealed ? &*sealed : nullptr, settings_.done);
    if (labels_.home.empty()) labels_ = labelSides(pieces_, sides_, crumb, parting, nullptr, settings_.done);  // all is smaller than a cell
    if (caster_ && settings_.merge_error > 0) {
      set_.unmerged = labels_.home.size();
      mergePatches(scene_, *caster_, {s, settings_.merge_error, settings_.metals}, pieces_, sides_, labels_);
    }
    measure();
    if (fences) findDoubles(*fences);
    keepSealed();
    return std::move(set_);
  }

 private:
  Result<void> cutTriangles(const PieceCutter& cutter) {
    constexpr size_t kChunk = 1024, kTogether = 64;
    const size_t n = scene_.triangles.size(), chunks = (n + kChunk - 1) / kChunk;
    if (settings_.done) settings_.done->expect(n);
    set_.fineness_.resize(n);
    for (uint32_t t = 0; t < n; ++t) set_.fineness_[t] = static_cast<int8_t>(finenessOf(scene_, t));
    if (const double pieces = fewestPieces(scene_, static_cast<double>(settings_.cell_m)); pieces > kMostPieces)
      return Error{ErrorCode::kUsage, scene_.name, "",
                   "this patch size would make about " + std::to_string(static_cast<uint64_t>(pieces)) + " pieces",
                   "use a larger --patch-size"};
    // Surfaces that stand on each other are cut where they meet, into how many is not known before.
    std::atomic<uint64_t> made{0};
    const auto tooMany = [&] { return static_cast<double>(made.load(std::memory_order_relaxed)) > settings_.max_pieces; };
    set_.piece_start_.assign(n + 1, 0);
    for (size_t first = 0; first < chunks && !tooMany(); first += kTogether) {
      std::vector<PieceList> parts(std::min(kTogether, chunks - first));
      tbb::parallel_for(size_t{0}, parts.size(), [&](size_t c) {
        if (tooMany()) return;
        const size_t begin = (first + c) * kChunk, end = std::min(n, begin + kChunk);
        for (size_t t = begin; t < end; ++t) {
          cutter.cut(static_cast<uint32_t>(t), parts[c]);
          if (settings_.done) settings_.done->add();
        }
        made += parts[c].size();
        parts[c].close();
      });
      for (PieceList& part : parts) {
        for (const Piece& p : part) {
          ++set_.piece_start_[p.triangle + 1];
          pieces_.add(p);
        }
        part = {};
      }
    }
    pieces_.close();
    if (tooMany())
      return Error{ErrorCode::kUsage, scene_.name, "",
                   "its surfaces cut each other into more than " + std::to_string(static_cast<uint64_t>(settings_.max_pieces)) + " pieces",
                   "use a larger --patch-size"};
    giveBackMemory();
    for (size_t t = 0; t < n; ++t) set_.piece_start_[t + 1] += set_.piece_start_[t];
    if (pieces_.empty())
      return Error{ErrorCode::kInvalidFile, scene_.name, "", "no surface with an area", "export the meshes' triangles"};
    return {};
  }

  void makeSides() {
    sides_.reserve(pieces_.size());
    for (uint32_t i = 0; i < pieces_.size(); ++i) {
      const int fineness = pieces_[i].fineness;
      const uint64_t key = hilbertKey(baseCell(pieces_[i].cell, fineness));
      const uint16_t in_cell = placeInBaseCell(pieces_[i].cell, fineness);
      const uint32_t o = orientationOf(vectorArea(pieces_[i].polygon));
      const Material& material = scene_.materials[scene_.triangles[pieces_[i].triangle].material];
      const uint16_t lamp_group = lamps_.of_material[scene_.triangles[pieces_[i].triangle].material];
      for (uint32_t back = 0; back < static_cast<uint32_t>(patchedSides(material)); ++back)
        sides_.push_back({key, o ^ back, lamp_group, static_cast<int16_t>(fineness), in_cell, i, back});
    }
    tbb::parallel_sort(sides_.begin(), sides_.end());
  }

  // Triangulates the pieces by patch and averages what a patch carries.
  void measure() {
    giveBackMemory();
    set_.cell_m = settings_.cell_m;
    set_.patches.resize(labels_.home.size());
    for (size_t p = 0; p < set_.patches.size(); ++p) {
      const Side& side = sides_[labels_.home[p]];
      const int doublings = labels_.doublings.empty() ? 0 : labels_.doublings[p];
      Cell own = pieces_[side.piece].cell;
      for (int32_t& x : own) x >>= doublings;
      Patch& patch = set_.patches[p];
      if (doublings > 0) ++set_.merged[static_cast<size_t>(doublings) - 1];
      patch.fineness = side.fineness - doublings;
      patch.cell = baseCell(own, patch.fineness);
      patch.key = hilbertKey(patch.cell);
      patch.name = p > 0 && set_.patches[p - 1].key == patch.key ? set_.patches[p - 1].name + 1 : mix64(patch.key + 1);
      patch.orientation = side.orientation;
      patch.lamp_group = side.lamp_group;
    }
    keepOutlines();
    for (uint32_t i = 0; i < sides_.size(); ++i) {
      const uint32_t patch = labels_.patch_of[i];
      set_.pieces_[sides_[i].piece].patch[sides_[i].back] = patch;
      if (patch == kSealed)
        set_.sealed_m2 += length(vectorArea(pieces_[sides_[i].piece].polygon)) * static_cast<double>(settings_.cell_m) * static_cast<double>(settings_.cell_m);
    }
    const Grouped sides_of(labels_.patch_of, set_.patches.size());
    labels_ = {};
    uint32_t triangles = 0;
    for (size_t p = 0; p < set_.patches.size(); ++p) {
      set_.patches[p].first_triangle = triangles;
      for (const uint32_t i : sides_of.of(p)) triangles += static_cast<uint32_t>(pieces_[sides_[i].piece].polygon.size()) - 2;
      set_.patches[p].triangles = triangles - set_.patches[p].first_triangle;
    }
    set_.triangles.resize(triangles);
    tbb::parallel_for(size_t{0}, set_.patches.size(), [&](size_t p) { measurePatch(p, sides_of.of(p)); });
    release(sides_);
    for (const Patch& p : set_.patches) set_.area_m2 += static_cast<double>(p.area_m2);
  }

  // What rays meet of doubled surface counts for what stands for it.
  void findDoubles(const Fences& fences) {
    std::vector<std::array<uint32_t, 3>> doubles;  // piece, back, patch
    for (uint32_t i = 0; i < pieces_.size(); ++i)
      for (const uint32_t back : {0u, 1u}) {
        if (set_.pieces_[i].patch[back] != kSealed || !pieces_[i].doubled[back]) continue;
        const Point at = middle(pieces_[i].polygon);
        const Fences::Double other = fences.doubleOf(pieces_[i].triangle, back == 1, at);
        if (other.triangle == kNone) continue;
        if (const uint32_t patch = set_.patchAt(other.triangle, other.front, vec3Of(at * static_cast<double>(settings_.cell_m))); patch < set_.patches.size()) doubles.push_back({i, back, patch});
      }
    for (const auto& [piece, back, patch] : doubles) set_.pieces_[piece].patch[back] = patch;
  }

  // Sealed pieces by the patch that their triangle goes on in. Farther than a cell from all of its patches nobody sees them.
  void keepSealed() {
    for (size_t i = 0; i < pieces_.size(); ++i)
      for (const int back : {0, 1}) {
        if (set_.pieces_[i].patch[back] != kSealed) continue;
        const uint32_t patch = nearestPatch(i, back);
        if (patch == kNone) continue;
        eachTriangle(pieces_[i], back, [&](Vec3 a, Vec3 b, Vec3 c) { set_.sealed.push_back({a, b, c, pieces_[i].triangle, patch}); });
      }
    std::ranges::stable_sort(set_.sealed, {}, &SealedTriangle::patch);
  }

  // On one side of the triangle of piece i, of the patches in the piece's cell and those around it; kNone if none is there.
  uint32_t nearestPatch(size_t i, int back) const {
    const Piece& piece = pieces_[i];
    const Point from = middle(piece.polygon);
    const auto first = set_.pieces_.begin() + set_.piece_start_[piece.triangle], last = set_.pieces_.begin() + set_.piece_start_[piece.triangle + 1];
    uint32_t patch = kNone;
    double nearest = 1e300;
    for (int32_t x = -1; x <= 1; ++x)
      for (int32_t y = -1; y <= 1; ++y)
        for (int32_t z = -1; z <= 1; ++z) {
          const Cell cell{piece.cell[0] + x, piece.cell[1] + y, piece.cell[2] + z};
          for (const PatchSet::CutPiece& q : std::ranges::equal_range(first, last, cell, {}, &PatchSet::CutPiece::cell)) {
            if (q.patch[back] == kSealed || q.patch[back] == kNone) continue;
            const Point way = middle(pieces_[static_cast<size_t>(&q - set_.pieces_.data())].polygon) - from;
            if (const double d = dot(way, way); d < nearest) {
              nearest = d;
              patch = q.patch[back];
            }
          }
        }
    return patch;
  }

  // f(a, b, c): corners in metres, wound as seen from the front or back of a piece.
  template <class F>
  void eachTriangle(const Piece& piece, bool back, F f) const {
    const auto metres = [&](size_t i) { return vec3Of(piece.polygon[i] * static_cast<double>(settings_.cell_m)); };
    for (size_t i = 1; i + 1 < piece.polygon.size(); ++i) f(metres(0), metres(back ? i + 1 : i), metres(back ? i : i + 1));
  }

  // What patchAt() needs to tell the pieces of a triangle in one cell from each other.
  void keepOutlines() {
    set_.pieces_.resize(pieces_.size());
    const auto together = [&](size_t i, size_t j) {
      return j < pieces_.size() && pieces_[i].triangle == pieces_[j].triangle && pieces_[i].cell == pieces_[j].cell;
    };
    for (size_t i = 0; i < pieces_.size(); ++i) {
      PatchSet::CutPiece& piece = set_.pieces_[i];
      piece.cell = pieces_[i].cell;
      piece.first_rim = static_cast<uint32_t>(set_.rims_.size());
      if (!together(i, i + 1) && (i == 0 || !together(i - 1, i))) continue;
      const PolygonView polygon = pieces_[i].polygon;
      const Point normal = vectorArea(polygon);
      for (size_t k = 0; k < polygon.size(); ++k) {
        const Point side = polygon[(k + 1) % polygon.size()] - polygon[k];
        const Point inward = cross(normal, side);
        const double l = length(inward);
        if (l > 0) set_.rims_.push_back({polygon[k], inward * (1 / l)});
      }
      piece.rims = static_cast<uint32_t>(set_.rims_.size()) - piece.first_rim;
    }
  }

  void measurePatch(size_t p, std::span<const uint32_t> sides) {
    Patch& patch = set_.patches[p];
    uint32_t at = patch.first_triangle;
    double area = 0, solid = 0;
    SurfaceMean mean(settings_.metals);
    Point centre{0, 0, 0};
    Vec3 normal;
    const float s = settings_.cell_m;
    for (const uint32_t i : sides) {
      const Piece& piece = pieces_[sides_[i].piece];
      eachTriangle(piece, sides_[i].back, [&](Vec3 a, Vec3 b, Vec3 c) {
        PatchTriangle& t = set_.triangles[at++];
        t = {.a = a, .b = b, .c = c, .source = piece.triangle};
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
      });
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
  PieceList pieces_;  // by triangle
  PagedVector<Side> sides_;
  Labels labels_;
  PatchSet set_;
};

double fewestPieces(const Scene& scene, double cell_m) {
  double pieces = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t)
    pieces += 1 + static_cast<double>(triangleArea(scene, t)) / (cell_m * cell_m * faceCells(finenessOf(scene, t)));
  return pieces;
}

Result<PatchSet> makePatches(const Scene& scene, const PatchSettings& settings, const RayCaster* caster) {
  return PatchBuilder(scene, settings, caster).build();
}

std::vector<Cell> PatchSet::cellsOf(const Patch& patch) const {
  if (patch.fineness >= 0) return {patch.cell};
  constexpr double kBehind = 1e-3;  // cells: a face in a grid plane belongs to the cell behind it
  std::vector<Cell> cells;
  for (uint32_t k = patch.first_triangle; k < patch.first_triangle + patch.triangles; ++k) {
    const PatchTriangle& t = triangles[k];
    const Vec3 normal = normalized(cross(t.b - t.a, t.c - t.a));
    Cell lo, hi;
    for (int a = 0; a < 3; ++a) {
      const auto [least, most] = std::minmax({t.a[a], t.b[a], t.c[a]});
      const auto cellAt = [&](float x, double inside) {
        return static_cast<int32_t>(std::floor(static_cast<double>(x) / static_cast<double>(cell_m) + inside - kBehind * static_cast<double>(normal[a])));
      };
      lo[static_cast<size_t>(a)] = cellAt(least, least < most ? kBehind : 0);
      hi[static_cast<size_t>(a)] = std::max(lo[static_cast<size_t>(a)], cellAt(most, least < most ? -kBehind : 0));
    }
    for (int32_t x = lo[0]; x <= hi[0]; ++x)
      for (int32_t y = lo[1]; y <= hi[1]; ++y)
        for (int32_t z = lo[2]; z <= hi[2]; ++z) {
          const Vec3 middle = Vec3{static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f, static_cast<float>(z) + 0.5f} * cell_m;
          const float reach = (std::abs(normal.x) + std::abs(normal.y) + std::abs(normal.z)) * 0.5f * cell_m;
          if (std::abs(dot(normal, middle - t.a)) <= reach * 1.0001f) cells.push_back({x, y, z});
        }
  }
  std::sort(cells.begin(), cells.end());
  cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
  return cells;
}

uint32_t PatchSet::searchPatch(uint32_t t, bool front, Vec3 p) const {
  const auto first = pieces_.begin() + piece_start_[t], last = pieces_.begin() + piece_start_[t + 1];
  if (first == last) return kNone;
  const auto find = [&](const Cell& cell) {
    const auto at = std::lower_bound(first, last, cell, [](const CutPiece& q, const Cell& c) { return q.cell < c; });
    return at != last && at->cell == cell ? at : last;
  };
  Cell own;
  const float edge_m = cell_m * static_cast<float>(edgeCells(fineness_[t]));
  for (int a = 0; a < 3; ++a) own[static_cast<size_t>(a)] = static_cast<int32_t>(std::floor(p[a] / edge_m));
  auto best = find(own);
  if (best == last) {  // in a grid plane, or on the border of a cell: the nearest cell
    float nearest = 1e30f;
    const auto consider = [&](auto q) {
      Box box;
      const Vec3 lo{static_cast<float>(q->cell[0]), static_cast<float>(q->cell[1]), static_cast<float>(q->cell[2])};
      box.add(lo * edge_m);
      box.add((lo + Vec3{1, 1, 1}) * edge_m);
      if (const float d = box.distance(p); d < nearest) {
        nearest = d;
        best = q;
      }
    };
    if (last - first <= 64) {
      for (auto q = first; q != last; ++q) consider(q);
    } else {
      for (int32_t dx = -1; dx <= 1; ++dx)
        for (int32_t dy = -1; dy <= 1; ++dy)
          for (int32_t dz = -1; dz <= 1; ++dz)
            if (const auto q = find({own[0] + dx, own[1] + dy, own[2] + dz}); q != last) consider(q);
    }
    if (best == last) best = first;
  }
  // Of the pieces in the cell, the one that the point lies in, or least outside of.
  const auto s = static_cast<double>(cell_m);
  const Point at{static_cast<double>(p.x) / s, static_cast<double>(p.y) / s, static_cast<double>(p.z) / s};
  double deepest = -1e300;
  const Cell cell = best->cell;
  for (auto q = best; q != last && q->cell == cell; ++q) {
    double depth = 1e300;
    for (uint32_t k = q->first_rim; k < q->first_rim + q->rims; ++k) depth = std::min(depth, dot(rims_[k].inward, at - rims_[k].at));
    if (depth > deepest) {
      deepest = depth;
      best = q;
    }
  }
  return best->patch[front ? 0 : 1];
}

}  // namespace ff::bake
