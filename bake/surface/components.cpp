#include "bake/surface/components.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "bake/surface/fineness.h"
#include "bake/surface/grouped.h"
#include "bake/surface/union_find.h"

namespace ff::bake {
namespace {

constexpr size_t kMaxPairs = 400;  // pieces of one place: past this it is crowded, and crumbs are joined by nearness anyway
constexpr double kOwnPatch = 0.1;   // of a crumb's largest area: a fenced one that is larger has a patch of its own
constexpr int kSteps = 2;           // from crumb to crumb to a patch: out of the corner of a room
constexpr double kTiny = 0.02;      // likewise: crumbs that are less together join a patch of another orientation

// The box around corners in a cell and half the width of a border around it, in twelve bytes: in steps of the cell's edge, a step wider.
class PackedExtent {
 public:
  PackedExtent() = default;
  PackedExtent(std::span<const Point> corners, const Cell& cell, int fineness) {
    const Extent e = extentOf(corners);
    const double edge = edgeCells(fineness);
    for (size_t i = 0; i < 3; ++i) {
      const auto steps = [&](double x) { return std::floor((x / edge - cell[i]) * kSteps) + kBelow; };
      const int a = static_cast<int>(i);
      lo_[i] = static_cast<uint16_t>(std::clamp(steps(e.lo[a] - kBorderCells / 2) - 1, 0.0, 65535.0));
      hi_[i] = static_cast<uint16_t>(std::clamp(steps(e.hi[a] + kBorderCells / 2) + 2, 0.0, 65535.0));
    }
  }
  // False: they are farther apart than the width of a border. Of the same cell.
  bool meets(const PackedExtent& other) const {
    bool all = true;
    for (size_t i = 0; i < 3; ++i) all &= lo_[i] <= other.hi_[i] && other.lo_[i] <= hi_[i];
    return all;
  }

 private:
  static constexpr double kSteps = 32768, kBelow = 1024;  // what juts out farther is cut off, and meets what does so as well
  std::array<uint16_t, 3> lo_{}, hi_{};
};

class Labeller {
 public:
  Labeller(std::span<const Piece> pieces, std::span<const Side> sides, double crumb, const Fences* fences, const SealedSurface* sealed,
           WorkCount* done)
      : pieces_(pieces), sides_(sides), crumb_(crumb), fences_(fences), sealed_(sealed), done_(done), root_(sides.size()),
        kind_(sides.size(), Kind::kNone), parted_(sides.size(), 0), area_(sides.size(), 0), centre_(sides.size()), extent_(sides.size()) {}

  Labels label() {
    for (size_t i = 0; i < sides_.size(); ++i)
      if (i == 0 || sides_[i].place() != sides_[i - 1].place()) place_start_.push_back(i);
    const size_t places = place_start_.size();
    place_start_.push_back(sides_.size());
    tbb::parallel_for(size_t{0}, sides_.size(), [&](size_t i) { extent_[i] = {piece(i).polygon, piece(i).cell, piece(i).fineness}; });
    tbb::parallel_for(size_t{0}, places, [&](size_t g) { connect(place_start_[g], place_start_[g + 1]); });
    members_ = Grouped(root_, sides_.size());
    if (done_) done_->expect(sides_.size());
    tbb::parallel_for(size_t{0}, sides_.size(), [&](size_t i) {
      judge(i);
      if (done_) done_->add();
    });
    std::vector<uint32_t> host(sides_.size(), kNobody);
    for (int step = 0; step < kSteps; ++step) {
      const std::vector<uint32_t> before = host;
      tbb::parallel_for(size_t{0}, sides_.size(), [&](size_t i) {
        if (kind_[i] == Kind::kCrumb && host[i] == kNobody) host[i] = goesOnIn(i, before);
      });
    }
    tbb::parallel_for(size_t{0}, sides_.size(), [&](size_t i) {
      if (kind_[i] == Kind::kCrumb && host[i] == kNobody && isSealed(i)) kind_[i] = Kind::kSealed;
    });
    for (uint32_t i = 0; i < sides_.size(); ++i)
      if (kind_[i] == Kind::kWhole) whole_.push_back(i);
    tbb::parallel_for(size_t{0}, places, [&](size_t g) { placeCrumbs(place_start_[g], place_start_[g + 1], host); });
    Labels labels;
    std::vector<uint32_t> patch(sides_.size(), kSealed);  // per root
    for (size_t g = 0; g < places; ++g) number(place_start_[g], place_start_[g + 1], host, patch, labels.home);
    for (size_t i = 0; i < sides_.size(); ++i)
      if (host[i] != kNobody) patch[i] = patch[host[i]];
    labels.patch_of.resize(sides_.size());
    for (size_t i = 0; i < sides_.size(); ++i) labels.patch_of[i] = patch[root_[i]];
    return labels;
  }

 private:
  enum class Kind : uint8_t { kNone, kWhole, kCrumb, kSealed };  // kNone: not a root
  static constexpr uint32_t kNobody = 0xffffffff;

  const Piece& piece(size_t i) const { return pieces_[sides_[i].piece]; }
  double crumbOf(size_t i) const { return crumb_ * faceCells(piece(i).fineness); }  // in base cells' faces
  PieceSide at(size_t i) const { return {&piece(i), sides_[i].back == 1}; }
  bool isFenced(size_t i) const {
    const uint32_t back = sides_[i].back;
    return fences_ && (piece(i).fenced[back] || piece(i).covered[back]);
  }

  void connect(size_t begin, size_t end) {
    UnionFind sets(end - begin);
    const auto n = static_cast<uint32_t>(end - begin);
    if (n > 1) {
      std::vector<std::pair<GridCorner, uint32_t>> corners;
      for (uint32_t i = 0; i < n; ++i) {
        if (isFenced(begin + i)) continue;
        const Cell cell = baseCell(piece(begin + i).cell, piece(begin + i).fineness);
        for (const Point& p : piece(begin + i).polygon) corners.emplace_back(gridCorner(p, cell, 1), i);
      }
      std::sort(corners.begin(), corners.end());
      for (size_t k = 1; k < corners.size(); ++k)
        if (corners[k].first == corners[k - 1].first) sets.join(corners[k].second, corners[k - 1].second);
      if (n <= kMaxPairs)
        for (uint32_t i = 0; i < n; ++i)
          for (uint32_t j = i + 1; j < n; ++j)
            if (extent_[begin + i].meets(extent_[begin + j]) && sets.find(i) != sets.find(j)) joinPair(begin, i, j, sets);
    }
    for (uint32_t i = 0; i < n; ++i) root_[begin + i] = static_cast<uint32_t>(begin) + sets.find(i);
    if (std::any_of(parted_.begin() + static_cast<ptrdiff_t>(begin), parted_.begin() + static_cast<ptrdiff_t>(end), [](uint8_t p) { return p; }))
      dissolveBent(begin, end);
  }

  // Surface around the corner of a wall, whose centroid lies on the other side: what a patch is like at its centroid must hold for it.
  void dissolveBent(size_t begin, size_t end) {
    std::vector<Point> moment(end - begin);
    std::vector<double> area(end - begin, 0);
    for (size_t i = begin; i < end; ++i) {
      const double own = length(vectorArea(piece(i).polygon));
      area[root_[i] - begin] += own;
      moment[root_[i] - begin] = moment[root_[i] - begin] + middle(piece(i).polygon) * own;
    }
    std::vector<uint8_t> bent(end - begin, 0);
    for (size_t r = 0; r < area.size(); ++r)
      if (area[r] > 0)
        for (size_t i = begin; i < end; ++i)
          if (root_[i] != begin + r && parted_[i] && !piece(i).covered[sides_[i].back] && contains(piece(i).polygon, moment[r] * (1 / area[r]), kBorderCells)) bent[r] = 1;
    for (size_t i = begin; i < end; ++i)
      if (bent[root_[i] - begin]) root_[i] = static_cast<uint32_t>(i);
  }

  void joinPair(size_t begin, uint32_t i, uint32_t j, UnionFind& sets) {
    if (!isFenced(begin + i) && !isFenced(begin + j)) {
      if (touches(piece(begin + i).polygon, piece(begin + j).polygon, kBorderCells)) sets.join(i, j);
      return;
    }
    switch (fences_->between(at(begin + i), at(begin + j))) {
      case Fences::Border::kOpen: sets.join(i, j); break;
      case Fences::Border::kClosed: parted_[begin + i] = parted_[begin + j] = 1; break;
      case Fences::Border::kApart: break;
    }
  }

  bool isSealed(size_t root) const {
    if (!sealed_) return false;
    std::vector<PieceSide> surface;
    for (const uint32_t i : members_.of(root)) surface.push_back(at(i));
    return sealed_->isSealed(surface);
  }

  void judge(size_t root) {
    if (root_[root] != root) return;
    double area = 0;
    Point moment;
    for (const uint32_t i : members_.of(root)) {
      const double own = length(vectorArea(piece(i).polygon));
      area += own;
      moment = moment + middle(piece(i).polygon) * own;
      parted_[root] |= parted_[i];
    }
    area_[root] = area;
    centre_[root] = moment * (1 / std::max(area, 1e-30));
    kind_[root] = area < crumbOf(root) ? Kind::kCrumb : isSealed(root) ? Kind::kSealed : Kind::kWhole;
  }

  // The component, not a crumb, that a crumb shares most open border with, mostly in the next cell, or crumbs with such a host do; kNobody:
  // none.
  uint32_t goesOnIn(size_t crumb, const std::vector<uint32_t>& host) const {
    std::vector<std::pair<uint32_t, double>> hosts;
    for (const uint32_t i : members_.of(crumb)) {
      const Polygon& polygon = piece(i).polygon;
      const Point area = vectorArea(polygon);
      if (!(length(area) > 0)) continue;
      const Point normal = area * (1 / length(area));
      for (size_t k = 0; k < polygon.size(); ++k) {
        const Point a = polygon[k], side = polygon[(k + 1) % polygon.size()] - a;
        if (!(length(side) > 0)) continue;
        // Behind as well: a polygon in a grid plane belongs to the cell behind it.
        const Point outward = cross(side, normal) * (1 / length(side));
        const Point next = a + side * 0.5 + outward * kBorderCells - normal * (sides_[i].back ? -kBorderCells : kBorderCells);
        Cell cell;
        for (int d = 0; d < 3; ++d) cell[static_cast<size_t>(d)] = static_cast<int32_t>(std::floor(next[d] / edgeCells(piece(i).fineness)));
        if (cell != piece(i).cell || isFenced(i)) addHosts(i, k, cell, host, hosts);
      }
    }
    uint32_t best = kNobody;
    double longest = 0;
    for (const auto& [root, shared] : hosts)
      if (shared > longest || (shared == longest && root < best)) {
        longest = shared;
        best = root;
      }
    return best;
  }

  void addHosts(uint32_t crumb_side, size_t border, const Cell& cell, const std::vector<uint32_t>& host,
                std::vector<std::pair<uint32_t, double>>& hosts) const {
    Side place = sides_[crumb_side];
    place.key = hilbertKey(baseCell(cell, place.fineness));
    place.in_cell = placeInBaseCell(cell, place.fineness);
    const auto before = [](const Side& a, const Side& b) { return a.place() < b.place(); };
    const auto [first, last] = std::equal_range(sides_.begin(), sides_.end(), place, before);
    const Polygon& polygon = piece(crumb_side).polygon;
    const PackedExtent line(std::array{polygon[border], polygon[(border + 1) % polygon.size()]}, cell, place.fineness);
    std::vector<SharedBorder> borders;
    for (auto s = first; s != last; ++s) {
      const auto j = static_cast<size_t>(s - sides_.begin());
      if (!line.meets(extent_[j])) continue;
      const uint32_t to = kind_[root_[j]] == Kind::kWhole ? root_[j] : host[root_[j]];
      if (to == kNobody) continue;
      borders.clear();
      shareBorder(polygon, border, piece(j).polygon, kBorderCells, borders);
      for (const SharedBorder& shared : borders) {
        if (fences_ && !fences_->isOpen(at(crumb_side), at(j), shared)) continue;
        const double l = length(shared.line.b - shared.line.a);
        const auto known = std::find_if(hosts.begin(), hosts.end(), [&](const auto& h) { return h.first == to; });
        if (known == hosts.end()) {
          hosts.emplace_back(to, l);
        } else {
          known->second += l;
        }
      }
    }
  }

  bool isLoose(size_t root, const std::vector<uint32_t>& host) const { return kind_[root] == Kind::kCrumb && host[root] == kNobody; }
  bool isOwn(size_t root, const std::vector<uint32_t>& host) const {
    return kind_[root] == Kind::kWhole || (isLoose(root, host) && parted_[root] && area_[root] >= kOwnPatch * crumbOf(root));
  }

  bool sees(size_t crumb, size_t root) const {
    const auto members = members_.of(crumb);
    if (std::none_of(members.begin(), members.end(), [&](uint32_t i) { return isFenced(i); })) return true;
    return fences_->sees(at(crumb), at(root));
  }

  // Of some roots the nearest to a crumb, and what the crumb sees before what it does not: the other side of a wall may be nearer.
  struct Nearest {
    uint32_t root = kNobody;
    double square = 1e300;
    bool seen = false;
  };
  void consider(size_t crumb, size_t root, Nearest& best) const {
    const Point d = centre_[crumb] - centre_[root];
    const double square = dot(d, d);
    if (square >= best.square && best.seen) return;
    const bool seen = sees(crumb, root);
    if (seen == best.seen ? square < best.square : seen) best = {static_cast<uint32_t>(root), square, seen};
  }

  // Finds hosts for crumbs that see no patch of their place, and for those that would make a patch too small to be of use: of the
  // same base cell or, if that has none, the cells around it. Here alone surface of one grid may join a patch of another.
  void placeCrumbs(size_t begin, size_t end, std::vector<uint32_t>& host) const {
    double area = 0;
    std::vector<uint32_t> own, loose;
    listPlace(begin, end, host, own, loose);
    for (const uint32_t i : loose) area += area_[i];
    if (own.empty() && area >= kTiny * crumbOf(begin)) return;
    for (const uint32_t i : loose) {
      const bool seen = std::any_of(own.begin(), own.end(), [&](uint32_t w) { return sees(i, w); });
      if (seen) continue;
      const Nearest other = nearestWhole(i);
      if (own.empty() || other.seen) host[i] = other.root;
    }
  }

  Nearest nearestWhole(size_t root) const {
    Nearest best;
    const auto look = [&](const Cell& cell) {
      const uint64_t key = hilbertKey(cell);
      for (const uint32_t j : std::ranges::equal_range(whole_, key, {}, [&](uint32_t i) { return sides_[i].key; }))
        if (sides_[j].lamp_group == sides_[root].lamp_group) consider(root, j, best);
    };
    const int fineness = piece(root).fineness;
    const Cell own = baseCell(piece(root).cell, fineness);
    look(own);
    const int32_t step = fineness < 0 ? 1 << -fineness : 1;
    if (!best.seen)
      for (int32_t n = 0; n < 27; ++n) look({own[0] + step * (n % 3 - 1), own[1] + step * (n / 3 % 3 - 1), own[2] + step * (n / 9 - 1)});
    return best;
  }

  // Of one place, what has a patch of its own and the crumbs that look for one.
  void listPlace(size_t begin, size_t end, const std::vector<uint32_t>& host, std::vector<uint32_t>& own, std::vector<uint32_t>& loose) const {
    for (size_t i = begin; i < end; ++i) {
      if (isOwn(i, host)) {
        own.push_back(static_cast<uint32_t>(i));
      } else if (isLoose(i, host)) {
        loose.push_back(static_cast<uint32_t>(i));
      }
    }
  }

  // Numbers the patches of one place.
  void number(size_t begin, size_t end, const std::vector<uint32_t>& host, std::vector<uint32_t>& patch, std::vector<uint32_t>& home) const {
    std::vector<uint32_t> own, loose;
    listPlace(begin, end, host, own, loose);
    if (own.empty() && !loose.empty()) own.push_back(loose[0]);  // crumbs only: one patch together
    for (const uint32_t i : own) {
      patch[i] = static_cast<uint32_t>(home.size());
      home.push_back(i);
    }
    for (const uint32_t i : loose) {
      Nearest best;
      for (const uint32_t w : own) consider(i, w, best);
      patch[i] = patch[best.root];
    }
  }

  const std::span<const Piece> pieces_;
  const std::span<const Side> sides_;
  const double crumb_;  // of a cell's face
  const Fences* const fences_;
  const SealedSurface* const sealed_;
  WorkCount* const done_;
  std::vector<size_t> place_start_;
  std::vector<uint32_t> root_;           // per side: the first side of its component
  std::vector<Kind> kind_;               // per root, as all below
  std::vector<uint8_t> parted_;          // a fence stands between it and a neighbour
  std::vector<double> area_;
  std::vector<Point> centre_;
  std::vector<PackedExtent> extent_;      // per side
  Grouped members_;                       // sides by component
  std::vector<uint32_t> whole_;           // roots with a patch of their own, by place
};

}  // namespace

Labels labelSides(std::span<const Piece> pieces, std::span<const Side> sides, double crumb_fraction, const Fences* fences,
                  const SealedSurface* sealed, WorkCount* done) {
  return Labeller(pieces, sides, crumb_fraction, fences, sealed, done).label();
}

}  // namespace ff::bake
