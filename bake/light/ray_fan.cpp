#include "bake/light/ray_fan.h"

#include <algorithm>
#include <cmath>

#include "bake/light/row_hits.h"
#include "bake/wide.h"

namespace ff::bake {
namespace {

constexpr double kTelling = 32;  // rays of a half towards a patch that tell whether anything is in the way
constexpr size_t kTriedAtOnce = 64;  // rays that are tried by one loop after the other

// Of rays whether they come through a sphere, and are among the first `few` of their half. The sphere's centre is seen from where origins are; most: its
// radius squared.
struct ComeNear {
  [[gnu::always_inline]] static void run(const float* const* origin, const float* const* direction, size_t first, const uint32_t* place, Vec3 centre, float most,
                                         uint32_t few, size_t rays, uint32_t* near) {
    const float *ox = origin[0] + first, *oy = origin[1] + first, *oz = origin[2] + first;
    const float *dx = direction[0] + first, *dy = direction[1] + first, *dz = direction[2] + first;
    for (size_t k = 0; k < rays; ++k) {
      const float x = centre.x - ox[k], y = centre.y - oy[k], z = centre.z - oz[k], along = x * dx[k] + y * dy[k] + z * dz[k];
      near[k] = static_cast<uint32_t>(x * x + y * y + z * z - along * along <= most) & static_cast<uint32_t>(place[k] < few);
    }
  }
};

// Adds 1 to times[k] where ray k comes through a facet from the front; at most kTriedAtOnce rays.
struct ComeThrough {
  [[gnu::always_inline]] static void run(const PatchShape::Facet* facet, const double* const* origin, const double* const* direction, size_t first, size_t rays,
                                         double* times) {
    const double *ox = origin[0] + first, *oy = origin[1] + first, *oz = origin[2] + first;
    const double *dx = direction[0] + first, *dy = direction[1] + first, *dz = direction[2] + first;
    const Point n = facet->normal, corner = facet->corner[0];
    alignas(64) double x[kTriedAtOnce], y[kTriedAtOnce], z[kTriedAtOnce], through[kTriedAtOnce];  // where rays meet the plane; 0 or 1
    for (size_t k = 0; k < rays; ++k) {
      const double towards = -(dx[k] * n.x + dy[k] * n.y + dz[k] * n.z);
      const double height = (ox[k] - corner.x) * n.x + (oy[k] - corner.y) * n.y + (oz[k] - corner.z) * n.z, distance = height / towards;
      x[k] = ox[k] + dx[k] * distance;
      y[k] = oy[k] + dy[k] * distance;
      z[k] = oz[k] + dz[k] * distance;
      through[k] = towards > 0 ? (distance > 0 ? 1.0 : 0.0) : 0.0;
    }
    for (size_t i = 0; i < facet->corners; ++i) {
      const Point from = facet->corner[i], side = facet->corner[i + 1 < facet->corners ? i + 1 : 0] - from;
      for (size_t k = 0; k < rays; ++k) {
        const double ax = x[k] - from.x, ay = y[k] - from.y, az = z[k] - from.z;
        const double inward = (side.y * az - side.z * ay) * n.x + (side.z * ax - side.x * az) * n.y + (side.x * ay - side.y * ax) * n.z;
        through[k] = inward < 0 ? 0.0 : through[k];
      }
    }
    for (size_t k = 0; k < rays; ++k) times[k] += through[k];
  }
};

template <class T>
std::array<const T*, 3> axes(const std::array<std::vector<T>, 3>& of) {
  return {of[0].data(), of[1].data(), of[2].data()};
}

}  // namespace

// Sobol points are spread more evenly than that: of pairs in towns and rooms one of a thousand is off by more.
bool isLikely(uint32_t found, double expected) { return std::abs(found - expected) <= 2 * std::sqrt(expected) + 1; }

int RayFan::binAt(double x) { return std::clamp(static_cast<int>((x + 1) * (kSide / 2)), 0, kSide - 1); }

void RayFan::assign(const PatchShape& from, Vec3 normal, std::span<const Ray> rays, std::span<const uint32_t> met) {
  const size_t n = rays.size();
  half_ = firstHalf(n);
  frame_ = frameOf(normal);
  centre_ = from.centre;
  radius_m_ = from.radius_m;
  bin_.resize(n);
  for (auto* axes : {&origin_, &direction_})
    for (std::vector<float>& axis : *axes) axis.resize(n);
  place_.resize(n);
  second_.resize(n);
  met_.resize(n);
  start_.fill(0);
  for (size_t k = 0; k < n; ++k) {
    const auto along = [&](Vec3 axis) { return binAt(static_cast<double>(dot(rays[k].direction, axis))); };
    bin_[k] = static_cast<uint16_t>(along(frame_.bitangent) * kSide + along(frame_.tangent));
    ++start_[bin_[k] + size_t{1}];
  }
  for (size_t b = 1; b < start_.size(); ++b) start_[b] += start_[b - 1];
  std::array<uint32_t, kSide * kSide> next;
  std::copy(start_.begin(), start_.end() - 1, next.begin());
  for (size_t k = 0; k < n; ++k) {
    const size_t to = next[bin_[k]]++;
    const Vec3 origin = vec3Of(pointOf(rays[k].origin) - centre_);
    for (int axis = 0; axis < 3; ++axis) {
      origin_[static_cast<size_t>(axis)][to] = origin[axis];
      direction_[static_cast<size_t>(axis)][to] = rays[k].direction[axis];
    }
    second_[to] = k >= half_;
    place_[to] = static_cast<uint32_t>(k - (k >= half_ ? half_ : 0));
    met_[to] = met[k];
  }
}

RayFan::Share RayFan::towards(uint32_t patch, const PatchShape& shape, double expected) {
  const Point way = shape.centre - centre_;
  const double apart = length(way), sine = (radius_m_ + shape.radius_m) / apart;
  Bins bins{0, kSide - 1, 0, kSide - 1};
  if (sine < 1) {  // no direction from one sphere to the other is farther than this from the one between their centres
    const double off = std::sqrt(2 - 2 * std::sqrt(1 - sine * sine)) + 1e-6;
    const double x = dot(way, pointOf(frame_.tangent)) / apart, y = dot(way, pointOf(frame_.bitangent)) / apart;
    bins = {binAt(x - off), binAt(x + off), binAt(y - off), binAt(y + off)};
  }
  size_t few = half_;
  for (double left = expected / 2; left >= 2 * kTelling && few > 1; left /= 2) few /= 2;
  if (few < half_) {  // each half's first ones are as well stratified as all
    Share some = count(patch, shape, bins, few);
    some.expected = expected * static_cast<double>(few) / static_cast<double>(half_);
    if (some.all() && some.isLikely()) return some;
  }
  Share share = count(patch, shape, bins, half_);
  share.expected = expected;
  return share;
}

RayFan::Share RayFan::count(uint32_t patch, const PatchShape& shape, const Bins& bins, size_t of_half) {
  findNear(shape, bins, of_half);
  Share share;
  const bool once = !shape.overlaps();
  tried_.clear();
  for (const uint32_t k : near_) {
    const bool there = met_[k] == patch;
    share.there[second_[k]] += there;
    if (there && once) ++share.towards[second_[k]];
    else tried_.push_back(k);
  }
  tryFacets(shape);
  for (size_t t = 0; t < tried_.size(); ++t) {
    const uint32_t k = tried_[t];
    share.towards[second_[k]] += std::max(static_cast<uint32_t>(met_[k] == patch), static_cast<uint32_t>(times_[t]));
  }
  return share;
}

void RayFan::findNear(const PatchShape& shape, const Bins& bins, size_t of_half) {
  const Point offset = shape.centre - centre_;
  const auto most = static_cast<float>(shape.radius_m * shape.radius_m * 1.001 + 1e-5 * dot(offset, offset));
  const auto origin = axes(origin_), direction = axes(direction_);
  size_t found = 0;
  near_.resize(met_.size() + 1);  // one more to write to
  for (int y = bins.y0; y <= bins.y1; ++y) {
    size_t first = start_[static_cast<size_t>(y * kSide + bins.x0)];
    const size_t end = start_[static_cast<size_t>(y * kSide + bins.x1) + 1];
    for (; first < end; first += kTriedAtOnce) {
      const size_t n = std::min(kTriedAtOnce, end - first);
      alignas(64) std::array<uint32_t, kTriedAtOnce> near;
      onWidest<ComeNear>(origin.data(), direction.data(), first, place_.data() + first, vec3Of(offset), most, static_cast<uint32_t>(of_half), n, near.data());
      for (size_t k = 0; k < n; ++k) {
        near_[found] = static_cast<uint32_t>(first + k);
        found += near[k];
      }
    }
  }
  near_.resize(found);
}

void RayFan::tryFacets(const PatchShape& shape) {
  times_.assign(tried_.size(), 0);
  for (int axis = 0; axis < 3; ++axis) {
    const auto a = static_cast<size_t>(axis);
    tried_origin_[a].resize(tried_.size());
    tried_direction_[a].resize(tried_.size());
    for (size_t t = 0; t < tried_.size(); ++t) {
      tried_origin_[a][t] = static_cast<double>(origin_[a][tried_[t]]) + centre_[axis];
      tried_direction_[a][t] = static_cast<double>(direction_[a][tried_[t]]);
    }
  }
  const auto origin = axes(tried_origin_), direction = axes(tried_direction_);
  for (const PatchShape::Facet& f : shape.facets)
    for (size_t first = 0; first < tried_.size(); first += kTriedAtOnce)
      onWidest<ComeThrough>(&f, origin.data(), direction.data(), first, std::min(kTriedAtOnce, tried_.size() - first), times_.data() + first);
}

}  // namespace ff::bake
