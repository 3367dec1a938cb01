#include "bake/light/ray_fan.h"

#include <algorithm>
#include <cmath>

#include "bake/light/row_hits.h"

namespace ff::bake {
namespace {

constexpr double kTelling = 32;  // rays of a half towards a patch that tell whether anything is in the way

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

RayFan::Share RayFan::towards(uint32_t patch, const PatchShape& shape, double expected) const {
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

RayFan::Share RayFan::count(uint32_t patch, const PatchShape& shape, const Bins& bins, size_t of_half) const {
  Share share;
  for (int y = bins.y0; y <= bins.y1; ++y)
    countRun(patch, shape, start_[static_cast<size_t>(y * kSide + bins.x0)], start_[static_cast<size_t>(y * kSide + bins.x1) + 1], of_half, share);
  return share;
}

void RayFan::countRun(uint32_t patch, const PatchShape& shape, size_t first, size_t end, size_t of_half, Share& share) const {
  constexpr size_t kAtOnce = 64;
  const Point offset = shape.centre - centre_;
  const Vec3 centre = vec3Of(offset);
  const auto most = static_cast<float>(shape.radius_m * shape.radius_m * 1.001 + 1e-5 * dot(offset, offset));
  const auto few = static_cast<uint32_t>(of_half);
  const bool once = !shape.overlaps();
  for (; first < end; first += kAtOnce) {
    const size_t n = std::min(kAtOnce, end - first);
    std::array<uint32_t, kAtOnce> near;  // whether a ray comes through the sphere around the shape
    const float *ox = origin_[0].data() + first, *oy = origin_[1].data() + first, *oz = origin_[2].data() + first;
    const float *dx = direction_[0].data() + first, *dy = direction_[1].data() + first, *dz = direction_[2].data() + first;
    const uint32_t* place = place_.data() + first;
    for (size_t k = 0; k < n; ++k) {
      const float x = centre.x - ox[k], y = centre.y - oy[k], z = centre.z - oz[k], along = x * dx[k] + y * dy[k] + z * dz[k];
      near[k] = static_cast<uint32_t>(x * x + y * y + z * z - along * along <= most) & static_cast<uint32_t>(place[k] < few);
    }
    for (size_t k = 0; k < n; ++k) {
      if (!near[k]) continue;
      const bool there = met_[first + k] == patch;
      uint32_t times = there;
      if (!there || !once) {
        const auto point = [&](const float* px, const float* py, const float* pz) { return pointOf({px[k], py[k], pz[k]}); };
        const Point origin = point(ox, oy, oz) + centre_, direction = point(dx, dy, dz);
        uint32_t met = 0;
        for (const PatchShape::Facet& f : shape.facets) met += f.meets(origin, direction);
        times = std::max(times, met);
      }
      share.there[second_[first + k]] += there;
      share.towards[second_[first + k]] += times;
    }
  }
}

}  // namespace ff::bake
