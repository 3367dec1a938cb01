#include "bake/rays/ray_trail.h"

#include <algorithm>
#include <cmath>

namespace ff::bake {

bool CubeBox::holds(const Cube& cube) const {
  for (size_t a = 0; a < 3; ++a)
    if (cube[a] < lo[a] || cube[a] - lo[a] >= size[a]) return false;
  return true;
}

uint32_t CubeBox::number(const Cube& cube) const {
  const auto at = [&](size_t a) { return static_cast<size_t>(cube[a] - lo[a]); };
  return static_cast<uint32_t>(at(0) + static_cast<size_t>(size[0]) * (at(1) + static_cast<size_t>(size[1]) * at(2)));
}

CubeBox::Cube CubeBox::cube(uint32_t number) const {
  const auto x = static_cast<uint32_t>(size[0]), y = static_cast<uint32_t>(size[1]);
  return {lo[0] + static_cast<int32_t>(number % x), lo[1] + static_cast<int32_t>(number / x % y), lo[2] + static_cast<int32_t>(number / x / y)};
}

RayTrail::RayTrail(const CubeBox& box) : box_(box), per_m_(1 / static_cast<double>(box.edge_m)) {
  stride_ = {1, static_cast<size_t>(box.size[0]) + 2, 0};
  stride_[2] = stride_[1] * (static_cast<size_t>(box.size[1]) + 2);
  passed_.resize(stride_[2] * (static_cast<size_t>(box.size[2]) + 2) / 64 + 1);
}

void RayTrail::clear() {
  for (const size_t place : places_) passed_[place / 64] = 0;
  places_.clear();
  left_ = false;
}

std::vector<uint32_t> RayTrail::cubes() const {
  std::vector<uint32_t> cubes;
  for (const size_t place : places_) {
    const auto x = static_cast<int32_t>(place % stride_[1]) - 1, y = static_cast<int32_t>(place % stride_[2] / stride_[1]) - 1, z = static_cast<int32_t>(place / stride_[2]) - 1;
    if (const CubeBox::Cube cube{box_.lo[0] + x, box_.lo[1] + y, box_.lo[2] + z}; box_.holds(cube)) cubes.push_back(box_.number(cube));
  }
  std::sort(cubes.begin(), cubes.end());
  return cubes;
}

void RayTrail::pass(size_t place) {
  uint64_t& word = passed_[place / 64];
  const uint64_t bit = uint64_t{1} << place % 64;
  if (word & bit) return;
  word |= bit;
  places_.push_back(place);
}

// Signs of directions cannot be foreseen: no branch looks at one.
void RayTrail::add(const Ray& ray, double to_m) {
  constexpr double kAlmostAlong = 1e-30;  // 1/m: a ray in a plane across an axis goes so slowly along it
  std::array<double, 3> from, along, width;  // where it starts, in cubes; its way a metre; metres it takes for a cube, below 0 downwards
  double enters = 0, leaves = to_m;
  for (int a = 0; a < 3; ++a) {
    const auto i = static_cast<size_t>(a);
    const double way = static_cast<double>(ray.direction[a]) * per_m_;
    from[i] = static_cast<double>(ray.origin[a]) * per_m_ - box_.lo[i];
    along[i] = std::abs(way) < kAlmostAlong ? kAlmostAlong : way;
    width[i] = 1 / along[i];
    const double lo = -from[i] * width[i], hi = (box_.size[i] - from[i]) * width[i];
    enters = std::max(enters, std::min(lo, hi));
    leaves = std::min(leaves, std::max(lo, hi));
  }
  left_ |= enters > 0 || leaves < to_m;
  if (!(enters <= leaves)) return;
  // Where it is in a cube of the box, or rounding has it a hair outside: in one of those around.
  const auto cubeAt = [&](size_t i, double way_m) { return static_cast<size_t>(static_cast<ptrdiff_t>(from[i] + way_m * along[i]) + 1); };
  std::array<size_t, 3> start;
  for (size_t i = 0; i < 3; ++i) start[i] = std::clamp<size_t>(cubeAt(i, enters), 1, static_cast<size_t>(box_.size[i]));
  pass(start[0] * stride_[0] + start[1] * stride_[1] + start[2] * stride_[2]);
  // Axis by axis, the cubes that it enters through a face across that axis: no step waits for the one before. Through an edge it may go at once, as
  // what lies there is in all cubes around.
  for (size_t i = 0; i < 3; ++i) {
    const size_t j = (i + 1) % 3, k = (i + 2) % 3, up = along[i] > 0;
    const size_t step = (2 * up - 1) * stride_[i];  // wraps around downwards
    const double width_m = std::abs(width[i]);
    size_t place = start[i] * stride_[i];
    for (double way_m = (static_cast<double>(start[i] - 1 + up) - from[i]) * width[i]; way_m < leaves; way_m += width_m) {
      place += step;
      pass(place + cubeAt(j, way_m) * stride_[j] + cubeAt(k, way_m) * stride_[k]);
    }
  }
}

}  // namespace ff::bake
