#include "bake/surface/merging.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numeric>
#include <tuple>

#include "bake/rays/surface_sampling.h"
#include "bake/surface/fineness.h"
#include "bake/surface/grouped.h"
#include "bake/surface/union_find.h"
#include "formats/model.h"
#include "formats/portable_math.h"

namespace ff::bake {
namespace {

// The made-up light, of an open sky's: what grey surfaces reflect of the sky that half of them see, and of a sun 30 degrees high, 20 off an axis. What lights
// a patch counts as a quarter of an open sky at least: in a crevice that sees next to nothing next to nothing is off.
constexpr size_t kLightings = 5;  // a sun on each of four sides; none
constexpr float kGrey = 0.5f, kHalfSky = 0.5f, kSunOverSky = 3.5f, kDark = 0.25f;
constexpr std::array<Vec3, kLightings - 1> kLowSuns{{{0.8137977f, 0.5f, 0.2961981f}, {-0.2961981f, 0.5f, 0.8137977f}, {-0.8137977f, 0.5f, -0.2961981f}, {0.2961981f, 0.5f, -0.8137977f}}};
using Look = std::array<float, kLightings>;

// Directions that cover the sphere evenly. Gonzalez. Measurement of Areas on a Sphere Using Fibonacci and Latitude-Longitude Lattices. 2010.
std::vector<Vec3> lookDirections() {
  std::vector<Vec3> directions;
  for (uint32_t k = 0; k < kLookDirections; ++k) {
    const double y = 1 - (2.0 * k + 1) / kLookDirections, r = std::sqrt(1 - y * y), turns = k * 0.6180339887498949;
    const auto [sine, cosine] = sineCosineOfTurns(turns - std::floor(turns));
    directions.push_back({static_cast<float>(r * cosine), static_cast<float>(y), static_cast<float>(r * sine)});
  }
  return directions;
}

// A patch that may become part of a larger one.
struct Part {
  int16_t fineness;
  uint32_t orientation;
  uint64_t key;  // of the cell of its own grid
  uint32_t patch;
  auto cube(int doublings) const { return std::tuple(fineness, orientation, hilbertAncestor(key, doublings)); }
  auto order() const { return std::tuple(fineness, orientation, key, patch); }
};

struct Looks {  // what is known of it
  bool may = false;
  float area = 0;  // base cells' faces
  Vec3 normal, albedo;
  Vec3 point;              // m, on its largest piece
  uint32_t triangle = 0;   // of that
};

struct Merge {
  int doublings;
  std::vector<uint32_t> patches;  // ascending
};

class Merger {
 public:
  Merger(const Scene& scene, const RayCaster& caster, const MergeSettings& settings, const PieceList& pieces, std::span<const Side> sides, Labels& labels)
      : scene_(scene), caster_(caster.withoutHoles()), settings_(settings), pieces_(pieces), sides_(sides), labels_(labels), directions_(lookDirections()) {}

  void merge() {
    sides_of_ = Grouped(labels_.patch_of, labels_.home.size());  // sealed ones are of none
    known_.resize(labels_.home.size());
    tbb::parallel_for(size_t{0}, known_.size(), [&](size_t p) { known_[p] = know(p); });
    for (uint32_t p = 0; p < known_.size(); ++p) {
      const Side& home = sides_[labels_.home[p]];
      if (home.lamp_group != formats::kNoLampGroup) lamps_.push_back(middle(pieces_[home.piece].polygon));
      if (known_[p].may) parts_.push_back({home.fineness, home.orientation, hilbertKey(pieces_[home.piece].cell), p});
    }
    std::sort(lamps_.begin(), lamps_.end(), [](const Point& a, const Point& b) { return a.x < b.x; });
    tbb::parallel_sort(parts_.begin(), parts_.end(), [](const Part& a, const Part& b) { return a.order() < b.order(); });
    PagedVector<size_t> start;  // of cubes
    for (size_t i = 0; i < parts_.size(); ++i)
      if (i == 0 || parts_[i].cube(kMaxMergedLog) != parts_[i - 1].cube(kMaxMergedLog)) start.push_back(i);
    start.push_back(parts_.size());
    std::vector<std::vector<Merge>> merges(start.size() - 1);
    tbb::parallel_for(size_t{0}, merges.size(), [&](size_t c) { merges[c] = Cube(*this, std::span(parts_).subspan(start[c], start[c + 1] - start[c])).merges(); });
    renumber(merges);
  }

 private:
  Vec3 metres(const Point& p) const { return vec3Of(p * static_cast<double>(settings_.cell_m)); }

  // What lets the same share of light pass everywhere has none.
  bool hasHoles(const Material& material) const { return material.cutout && (material.base_image != kNone || !scene_.colors.empty()); }

  Looks know(size_t patch) const {
    const Side& home = sides_[labels_.home[patch]];
    Looks looks;
    if (home.lamp_group != formats::kNoLampGroup || home.fineness > 0 || home.fineness == -kMaxFineness) return looks;
    for (const uint32_t i : sides_of_.of(patch)) {
      const Piece& piece = pieces_[sides_[i].piece];
      const bool parted = piece.fenced[sides_[i].back] || piece.covered[sides_[i].back];
      if (parted || hasHoles(scene_.materials[scene_.triangles[piece.triangle].material]) || sides_[i].orientation != home.orientation || sides_[i].fineness != home.fineness) return looks;
    }
    SurfaceMean mean(settings_.metals);
    Point normal;
    double largest = -1;
    for (const uint32_t i : sides_of_.of(patch)) {
      const Piece& piece = pieces_[sides_[i].piece];
      const Point area = vectorArea(piece.polygon) * (sides_[i].back ? -1.0 : 1.0);
      normal = normal + area;
      looks.area += static_cast<float>(length(area));
      if (length(area) > largest) {
        largest = length(area);
        looks.point = metres(middle(piece.polygon));
        looks.triangle = piece.triangle;
      }
      for (size_t k = 1; k + 1 < piece.polygon.size(); ++k) {
        const Vec3 a = metres(piece.polygon[0]), b = metres(piece.polygon[k]), c = metres(piece.polygon[k + 1]);
        mean.add(scene_, piece.triangle, a, b, c, length(cross(b - a, c - a)) / 2);
      }
    }
    looks.normal = normalized(vec3Of(normal));
    looks.albedo = mean.albedo();
    looks.may = looks.area > 0;
    return looks;
  }

  // What a patch sees of the made-up light, of what an open sky would bring.
  Look lookFrom(const Looks& from) const {
    const Vec3 origin = from.point + from.normal * caster_.surfaceOffset(from.triangle);
    Look look{};
    float all = 0;
    for (const Vec3& d : directions_) {
      const float cosine = dot(d, from.normal);
      if (cosine <= 0) continue;
      all += cosine;
      const Hit hit = caster_.nearest({origin, d});
      if (hit.triangle == kNone) {
        for (float& light : look) light += cosine;
        continue;
      }
      const Triangle& t = scene_.triangles[hit.triangle];
      if (!hit.front && !scene_.materials[t.material].double_sided) continue;
      const Vec3 a = scene_.positions[t.v[0]], n = normalized(cross(scene_.positions[t.v[1]] - a, scene_.positions[t.v[2]] - a)) * (hit.front ? 1.0f : -1.0f);
      for (size_t l = 0; l < kLightings; ++l) look[l] += cosine * kGrey * (kHalfSky + (l < kLowSuns.size() ? kSunOverSky * std::max(0.0f, dot(n, kLowSuns[l])) : 0.0f));
    }
    for (float& light : look) light /= all;
    return look;
  }

  // The parts of one orientation in a cube of the largest size.
  class Cube {
   public:
    Cube(const Merger& merger, std::span<const Part> parts) : m_(merger), parts_(parts), taken_(parts.size()), seen_(parts.size()), look_(parts.size()) {}

    std::vector<Merge> merges() {
      if (parts_.size() > 1) {
        findBorders();
        cut(0, static_cast<uint32_t>(parts_.size()), std::min(kMaxMergedLog, kMaxFineness + parts_[0].fineness));
      }
      return std::move(merges_);
    }

   private:
    const Looks& known(uint32_t part) const { return m_.known_[parts_[part].patch]; }

    // Pairs of parts that share two corners: a border. Pieces that meet in a grid plane were cut at the same points.
    void findBorders() {
      std::vector<std::pair<GridCorner, uint32_t>> corners;
      const Cell from = m_.pieces_[m_.sides_[m_.labels_.home[parts_[0].patch]].piece].cell;
      const double edge = edgeCells(parts_[0].fineness);
      for (uint32_t i = 0; i < parts_.size(); ++i)
        for (const uint32_t side : m_.sides_of_.of(parts_[i].patch))
          for (const Point& p : m_.pieces_[m_.sides_[side].piece].polygon) corners.emplace_back(gridCorner(p, from, edge), i);
      std::sort(corners.begin(), corners.end());
      corners.erase(std::unique(corners.begin(), corners.end()), corners.end());
      std::vector<std::pair<uint32_t, uint32_t>> pairs;
      for (size_t k = 0; k < corners.size(); ++k)
        for (size_t j = k + 1; j < corners.size() && corners[j].first == corners[k].first; ++j) pairs.emplace_back(corners[k].second, corners[j].second);
      std::sort(pairs.begin(), pairs.end());
      for (size_t k = 1; k < pairs.size(); ++k)
        if (pairs[k] == pairs[k - 1] && (borders_.empty() || borders_.back() != pairs[k])) borders_.push_back(pairs[k]);
    }

    // What can be merged in the parts begin .. end - 1, which lie in one cube of 2^doublings cells, as a whole or in its eight.
    void cut(uint32_t begin, uint32_t end, int doublings) {
      if (doublings == 0 || end - begin < 2) return;
      UnionFind sets(end - begin);
      for (const auto& [i, j] : borders_)
        if (i >= begin && j < end && !taken_[i] && !taken_[j]) sets.join(i - begin, j - begin);
      std::vector<std::pair<uint32_t, uint32_t>> by_set;
      for (uint32_t i = begin; i < end; ++i)
        if (!taken_[i]) by_set.emplace_back(sets.find(i - begin), i);
      std::sort(by_set.begin(), by_set.end());
      std::vector<uint32_t> together;
      for (size_t k = 0; k < by_set.size();) {
        together.clear();
        const uint32_t set = by_set[k].first;
        for (; k < by_set.size() && by_set[k].first == set; ++k) together.push_back(by_set[k].second);
        const bool smaller = parts_[together.front()].cube(doublings - 1) == parts_[together.back()].cube(doublings - 1);
        if (smaller || !areAlike(together, doublings)) continue;
        Merge merge{doublings, {}};
        for (const uint32_t i : together) {
          taken_[i] = 1;
          merge.patches.push_back(parts_[i].patch);
        }
        std::sort(merge.patches.begin(), merge.patches.end());
        merges_.push_back(std::move(merge));
      }
      for (uint32_t i = begin; i < end;) {
        uint32_t next = i + 1;
        while (next < end && parts_[next].cube(doublings - 1) == parts_[i].cube(doublings - 1)) ++next;
        cut(i, next, doublings - 1);
        i = next;
      }
    }

    bool areAlike(std::span<const uint32_t> together, int doublings) {
      double area = 0;
      Vec3 normal, least{1, 1, 1}, most{0, 0, 0};
      Point centre;
      for (const uint32_t i : together) {
        const Looks& part = known(i);
        area += static_cast<double>(part.area);
        normal += part.normal * part.area;
        for (int a = 0; a < 3; ++a) centre[a] += static_cast<double>(part.area * part.point[a]);
        least = ff::min(least, part.albedo);
        most = ff::max(most, part.albedo);
      }
      normal = normalized(normal);
      centre = centre * (1 / (area * static_cast<double>(m_.settings_.cell_m)));
      for (const uint32_t i : together)
        if (dot(known(i).normal, normal) < kMergedTurn) return false;
      const Vec3 sum = least + most, spread = most - least;
      const float error = m_.settings_.error;
      if (std::max({spread.x, spread.y, spread.z}) > error * std::max({sum.x, sum.y, sum.z})) return false;
      if (facesLamp(centre, normal, kLampEdges * edgeCells(parts_[0].fineness) * (1 << doublings))) return false;
      // Far from each other first: what differs shows at once.
      Look dim, bright;
      dim.fill(1e30f);
      bright.fill(0);
      for (size_t step = std::bit_floor(together.size()); step > 0; step /= 2)
        for (size_t k = step - 1; k < together.size(); k += 2 * step)
          if (!addLook(together[k], error, dim, bright)) return false;
      return true;
    }

    bool addLook(uint32_t part, float error, Look& dim, Look& bright) {
      if (!seen_[part]) {
        look_[part] = m_.lookFrom(known(part));
        seen_[part] = 1;
      }
      for (size_t l = 0; l < kLightings; ++l) {
        dim[l] = std::min(dim[l], look_[part][l]);
        bright[l] = std::max(bright[l], look_[part][l]);
        if (bright[l] - dim[l] > error * std::max(bright[l] + dim[l], 2 * kDark)) return false;
      }
      return true;
    }

    bool facesLamp(const Point& centre, Vec3 normal, double within) const {
      const auto nearer = [](const Point& lamp, double x) { return lamp.x < x; };
      for (auto lamp = std::lower_bound(m_.lamps_.begin(), m_.lamps_.end(), centre.x - within, nearer); lamp != m_.lamps_.end() && lamp->x <= centre.x + within; ++lamp) {
        const Point way = *lamp - centre;
        if (dot(way, way) < within * within && dot(vec3Of(way), normal) > 0) return true;
      }
      return false;
    }

    const Merger& m_;
    const std::span<const Part> parts_;  // by cell
    std::vector<uint8_t> taken_, seen_;
    std::vector<Look> look_;
    std::vector<std::pair<uint32_t, uint32_t>> borders_;
    std::vector<Merge> merges_;
  };

  void renumber(std::span<const std::vector<Merge>> merges) {
    struct Place {
      Side side;
      uint32_t home;
      uint8_t doublings;
      std::span<const uint32_t> patches;  // before
    };
    PagedVector<Place> places;
    PagedVector<uint8_t> merged(labels_.home.size());
    for (const auto& of_cube : merges)
      for (const Merge& merge : of_cube) {
        const uint32_t home = labels_.home[merge.patches.front()];
        Side side = sides_[home];
        Cell cell = pieces_[side.piece].cell;
        for (int32_t& x : cell) x >>= merge.doublings;
        side.fineness = static_cast<int16_t>(side.fineness - merge.doublings);
        side.key = hilbertKey(baseCell(cell, side.fineness));
        side.in_cell = 0;
        places.push_back({side, home, static_cast<uint8_t>(merge.doublings), merge.patches});
        for (const uint32_t p : merge.patches) merged[p] = 1;
      }
    PagedVector<uint32_t> number(merged.size());
    std::iota(number.begin(), number.end(), 0u);
    const PagedVector<uint32_t> before = number;
    for (uint32_t p = 0; p < merged.size(); ++p)
      if (!merged[p]) places.push_back({sides_[labels_.home[p]], labels_.home[p], 0, std::span(before).subspan(p, 1)});
    PagedVector<uint32_t> order(places.size());
    std::iota(order.begin(), order.end(), 0u);
    tbb::parallel_sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return places[a].side < places[b].side; });
    Labels renumbered;
    for (uint32_t n = 0; n < order.size(); ++n) {
      const Place& place = places[order[n]];
      renumbered.home.push_back(place.home);
      renumbered.doublings.push_back(place.doublings);
      for (const uint32_t p : place.patches) number[p] = n;
    }
    renumbered.patch_of = std::move(labels_.patch_of);
    for (uint32_t& p : renumbered.patch_of)
      if (p != kSealed) p = number[p];
    labels_ = std::move(renumbered);
  }

  const Scene& scene_;
  const RayCaster caster_;
  const MergeSettings settings_;
  const PieceList& pieces_;
  const std::span<const Side> sides_;
  Labels& labels_;
  const std::vector<Vec3> directions_;
  Grouped sides_of_;                    // by patch
  PagedVector<Looks> known_;            // by patch
  PagedVector<Part> parts_;
  PagedVector<Point> lamps_;            // base cells, by x
};

}  // namespace

void mergePatches(const Scene& scene, const RayCaster& caster, const MergeSettings& settings, const PieceList& pieces, std::span<const Side> sides,
                  Labels& labels) {
  Merger(scene, caster, settings, pieces, sides, labels).merge();
}

}  // namespace ff::bake
