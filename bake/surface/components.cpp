#include "bake/surface/components.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

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
  void add(const PackedExtent& other) {
    for (size_t i = 0; i < 3; ++i) {
      lo_[i] = std::min(lo_[i], other.lo_[i]);
      hi_[i] = std::max(hi_[i], other.hi_[i]);
    }
  }

 private:
  static constexpr double kSteps = 32768, kBelow = 1024;  // what juts out farther is cut off, and meets what does so as well
  std::array<uint16_t, 3> lo_{}, hi_{};
};

class Labeller {
 public:
  Labeller(const PieceList& pieces, std::span<const Side> sides, double crumb, const Fences* fences, const SealedSurface* sealed,
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
    PagedVector<uint32_t> host(sides_.size(), kNobody);
    for (int step = 0; step < kSteps; ++step) {
      const PagedVector<uint32_t> before = host;
      const Hosts hosts = listHosts(before, step == 0);
      tbb::parallel_for(size_t{0}, places, [&](size_t g) {
        for (size_t i = place_start_[g]; i < place_start_[g + 1]; ++i)
          if (kind_[i] == Kind::kCrumb && host[i] == kNobody) host[i] = goesOnIn(i, g, before, hosts);
      });
    }
    tbb::parallel_for(size_t{0}, sides_.size(), [&](size_t i) {
      if (kind_[i] == Kind::kCrumb && host[i] == kNobody && isSealed(i)) kind_[i] = Kind::kSealed;
    });
    for (uint32_t i = 0; i < sides_.size(); ++i)
      if (kind_[i] == Kind::kWhole) whole_.push_back(i);
    tbb::parallel_for(size_t{0}, places, [&](size_t g) { placeCrumbs(place_start_[g], place_start_[g + 1], host); });
    Labels labels;
    PagedVector<uint32_t> patch(sides_.size(), kSealed);  // per root
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
      if (n > kMaxPairs) joinAlongEdges(begin, n, sets);
    }
    for (uint32_t i = 0; i < n; ++i) root_[begin + i] = static_cast<uint32_t>(begin) + sets.find(i);
    if (std::any_of(parted_.begin() + static_cast<ptrdiff_t>(begin), parted_.begin() + static_cast<ptrdiff_t>(end), [](uint8_t p) { return p; }))
      dissolveBent(begin, end);
  }

  // Neighbours in a mesh: pieces with an edge in common, of which at least one is fenced.
  void joinAlongEdges(size_t begin, uint32_t n, UnionFind& sets) {
    std::vector<std::tuple<GridCorner, GridCorner, uint32_t>> edges;
    std::vector<GridCorner> corners;
    for (uint32_t i = 0; i < n; ++i) {
      const Cell cell = baseCell(piece(begin + i).cell, piece(begin + i).fineness);
      corners.clear();
      for (const Point& p : piece(begin + i).polygon) corners.push_back(gridCorner(p, cell, 1));
      for (size_t k = 0; k < corners.size(); ++k) {
        const auto [first, last] = std::minmax(corners[k], corners[(k + 1) % corners.size()]);
        if (first != last) edges.emplace_back(first, last, i);
      }
    }
    std::sort(edges.begin(), edges.end());
    for (size_t k = 1; k < edges.size(); ++k) {
      const auto& [a, b, i] = edges[k - 1];
      const auto& [c, d, j] = edges[k];
      if (a == c && b == d && sets.find(i) != sets.find(j)) joinPair(begin, i, j, sets);
    }
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

  // The sides that crumbs may join, by place, and boxes around kRun of them at a time: crumbs look for hosts in crowded places.
  struct Hosts {
    static constexpr uint32_t kRun = 16;
    PagedVector<uint32_t> side, first;     // first: of each place
    PagedVector<PackedExtent> run;
    PagedVector<uint32_t> first_run;       // of each place
  };

  // Sides of components that are no crumbs; after the first step, of crumbs that have found one by then: what the others are open to, they have found.
  Hosts listHosts(const PagedVector<uint32_t>& host, bool first_step) const {
    const auto isHost = [&](size_t i) { return first_step ? kind_[root_[i]] == Kind::kWhole : host[root_[i]] != kNobody; };
    Hosts hosts;
    size_t sides = 0;
    for (size_t i = 0; i < sides_.size(); ++i) sides += isHost(i);
    hosts.side.reserve(sides);
    hosts.run.reserve(sides / Hosts::kRun + std::min(sides, place_start_.size()));
    for (size_t g = 0; g + 1 < place_start_.size(); ++g) {
      hosts.first.push_back(static_cast<uint32_t>(hosts.side.size()));
      hosts.first_run.push_back(static_cast<uint32_t>(hosts.run.size()));
      for (size_t i = place_start_[g]; i < place_start_[g + 1]; ++i) {
        if (!isHost(i)) continue;
        if ((hosts.side.size() - hosts.first.back()) % Hosts::kRun == 0) hosts.run.push_back(extent_[i]);
        else hosts.run.back().add(extent_[i]);
        hosts.side.push_back(static_cast<uint32_t>(i));
      }
    }
    hosts.first.push_back(static_cast<uint32_t>(hosts.side.size()));
    return hosts;
  }

  // A place that was looked for, so that the next border need not.
  struct FoundPlace {
    Cell cell{};
    size_t place = kNoPlace;
    static constexpr size_t kNoPlace = ~size_t{0};
  };

  // The component, not a crumb, that a crumb of a place shares most open border with, mostly in the next cell, or crumbs with such a host do; kNobody:
  // none.
  uint32_t goesOnIn(size_t crumb, size_t place, const PagedVector<uint32_t>& host, const Hosts& all) const {
    std::vector<std::pair<uint32_t, double>> hosts;
    FoundPlace found{piece(crumb).cell, place};
    for (const uint32_t i : members_.of(crumb)) {
      const PolygonView polygon = piece(i).polygon;
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
        if (cell == piece(i).cell) {
          if (isFenced(i)) addHosts(i, k, {cell, place}, host, all, hosts);
          continue;
        }
        if (found.cell != cell) found = {cell, placeOf(i, cell)};
        if (found.place != FoundPlace::kNoPlace) addHosts(i, k, found, host, all, hosts);
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

  // Where a side would be in another cell.
  size_t placeOf(uint32_t of, const Cell& cell) const {
    Side side = sides_[of];
    side.key = hilbertKey(baseCell(cell, side.fineness));
    side.in_cell = placeInBaseCell(cell, side.fineness);
    const auto end = place_start_.end() - 1;
    const auto at = std::partition_point(place_start_.begin(), end, [&](size_t first) { return sides_[first].place() < side.place(); });
    return at == end || sides_[*at].place() != side.place() ? FoundPlace::kNoPlace : static_cast<size_t>(at - place_start_.begin());
  }

  void addHosts(uint32_t crumb_side, size_t border, const FoundPlace& in, const PagedVector<uint32_t>& host, const Hosts& all,
                std::vector<std::pair<uint32_t, double>>& hosts) const {
    const uint32_t end = all.first[in.place + 1];
    if (all.first[in.place] == end) return;
    const PolygonView polygon = piece(crumb_side).polygon;
    const PackedExtent line(std::array{polygon[border], polygon[(border + 1) % polygon.size()]}, in.cell, piece(crumb_side).fineness);
    std::vector<SharedBorder> borders;
    size_t run = all.first_run[in.place];
    for (uint32_t first = all.first[in.place]; first < end; first += Hosts::kRun, ++run) {
      if (!line.meets(all.run[run])) continue;
      for (uint32_t k = first; k < std::min(end, first + Hosts::kRun); ++k) {
        const uint32_t j = all.side[k];
        if (!line.meets(extent_[j])) continue;
        const uint32_t to = kind_[root_[j]] == Kind::kWhole ? root_[j] : host[root_[j]];
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
  }

  bool isLoose(size_t root, const PagedVector<uint32_t>& host) const { return kind_[root] == Kind::kCrumb && host[root] == kNobody; }
  bool isOwn(size_t root, const PagedVector<uint32_t>& host) const {
    return kind_[root] == Kind::kWhole || (isLoose(root, host) && parted_[root] && area_[root] >= kOwnPatch * crumbOf(root));
  }

  // Of some roots the nearest that a crumb sees, or, where no fence is near it, that is in its space; where it sees none of them, the nearest in its space: the
  // other side of a wall may be nearer, or all there is. Of equally near ones the first.
  struct Nearest {
    uint32_t root = kNobody;
    double square = 1e300;
    bool seen = false;
  };
  Nearest nearest(size_t crumb, std::span<const uint32_t> roots) const {
    std::vector<std::pair<double, uint32_t>> by_distance;
    for (uint32_t k = 0; k < roots.size(); ++k) {
      const Point d = centre_[crumb] - centre_[roots[k]];
      by_distance.emplace_back(dot(d, d), k);
    }
    const auto members = members_.of(crumb);
    const bool free = std::none_of(members.begin(), members.end(), [&](uint32_t i) { return isFenced(i); });
    // In a grid coarser than the base cells a place is many spaces wide, and its own orientation counts for more.
    const auto near = [&](uint32_t root) { return !fences_ || piece(crumb).fineness < 0 || fences_->shareSpace(at(crumb), at(root)); };
    const std::greater<> farther;
    std::make_heap(by_distance.begin(), by_distance.end(), farther);
    std::vector<std::pair<double, uint32_t>> unseen;
    for (auto end = by_distance.end(); end != by_distance.begin(); --end) {
      std::pop_heap(by_distance.begin(), end, farther);
      const auto [square, k] = *(end - 1);
      if (free ? near(roots[k]) : fences_->sees(at(crumb), at(roots[k]))) return {roots[k], square, true};
      unseen.emplace_back(square, roots[k]);
    }
    if (free) return {};
    for (const auto& [square, root] : unseen)
      if (near(root)) return {root, square, false};
    return {};
  }

  // Finds hosts for crumbs of a place: what has a patch of its own there; for crumbs that see none, and for those that would make a patch too small to
  // be of use, what has one in the same base cell or, if they see nothing there, the cells around it. Here alone surface of one grid may join a patch of
  // another. Crumbs stay without where there is none: they are a patch together. Those that share no space with what there is, inside of a foot, have none if they
  // come to next to nothing.
  void placeCrumbs(size_t begin, size_t end, PagedVector<uint32_t>& host) {
    double area = 0;
    std::vector<uint32_t> own, loose;
    for (size_t i = begin; i < end; ++i) {
      if (isOwn(i, host)) {
        own.push_back(static_cast<uint32_t>(i));
      } else if (isLoose(i, host)) {
        loose.push_back(static_cast<uint32_t>(i));
        area += area_[i];
      }
    }
    if (own.empty() && area >= kTiny * crumbOf(begin)) return;
    std::vector<uint32_t> enclosed;
    double enclosed_area = 0;
    for (const uint32_t i : loose) {
      const Nearest here = nearest(i, own);
      host[i] = here.root;
      if (here.seen) continue;
      bool alone = own.empty();
      const Nearest other = nearestWhole(i, alone);
      if (here.root == kNobody || other.seen) host[i] = other.root;
      if (host[i] != kNobody || alone) continue;
      enclosed.push_back(i);
      enclosed_area += area_[i];
    }
    if (sides_[begin].lamp_group != formats::kNoLampGroup || enclosed_area >= kTiny * crumbOf(begin)) return;
    for (const uint32_t i : enclosed) kind_[i] = Kind::kSealed;
  }

  // alone: is false from then on if there is anything to join.
  Nearest nearestWhole(size_t root, bool& alone) const {
    std::vector<uint32_t> roots;
    const auto list = [&](const Cell& cell) {
      for (const uint32_t j : std::ranges::equal_range(whole_, hilbertKey(cell), {}, [&](uint32_t i) { return sides_[i].key; }))
        if (sides_[j].lamp_group == sides_[root].lamp_group) roots.push_back(j);
    };
    const int fineness = piece(root).fineness;
    const Cell own = baseCell(piece(root).cell, fineness);
    list(own);
    alone &= roots.empty();
    const Nearest here = nearest(root, roots);
    if (here.seen) return here;
    roots.clear();
    const int32_t step = fineness < 0 ? 1 << -fineness : 1;
    for (int32_t n = 0; n < 27; ++n)
      if (n != 13) list({own[0] + step * (n % 3 - 1), own[1] + step * (n / 3 % 3 - 1), own[2] + step * (n / 9 - 1)});
    alone &= roots.empty();
    const Nearest around = nearest(root, roots);
    return around.seen || around.square < here.square ? around : here;
  }

  // Numbers the patches of one place.
  void number(size_t begin, size_t end, const PagedVector<uint32_t>& host, PagedVector<uint32_t>& patch, PagedVector<uint32_t>& home) const {
    uint32_t together = kNobody;
    for (size_t i = begin; i < end; ++i) {
      if (isOwn(i, host)) {
        patch[i] = static_cast<uint32_t>(home.size());
        home.push_back(static_cast<uint32_t>(i));
      } else if (isLoose(i, host)) {
        if (together == kNobody) {
          together = static_cast<uint32_t>(home.size());
          home.push_back(static_cast<uint32_t>(i));
        }
        patch[i] = together;
      }
    }
  }

  const PieceList& pieces_;
  const std::span<const Side> sides_;
  const double crumb_;  // of a cell's face
  const Fences* const fences_;
  const SealedSurface* const sealed_;
  WorkCount* const done_;
  PagedVector<size_t> place_start_;
  PagedVector<uint32_t> root_;           // per side: the first side of its component
  PagedVector<Kind> kind_;               // per root, as all below
  PagedVector<uint8_t> parted_;          // a fence stands between it and a neighbour
  PagedVector<double> area_;
  PagedVector<Point> centre_;
  PagedVector<PackedExtent> extent_;      // per side
  Grouped members_;                       // sides by component
  PagedVector<uint32_t> whole_;           // roots with a patch of their own, by place
};

}  // namespace

Labels labelSides(const PieceList& pieces, std::span<const Side> sides, double crumb_fraction, const Fences* fences,
                  const SealedSurface* sealed, WorkCount* done) {
  return Labeller(pieces, sides, crumb_fraction, fences, sealed, done).label();
}

}  // namespace ff::bake
