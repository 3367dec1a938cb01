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
  const auto at = [&](size_t a) { return static_cast<uint32_t>(cube[a] - lo[a]); };
  const auto blocks = [&](size_t a) { return static_cast<uint32_t>(size[a] / kBlock); };
  const uint32_t block = at(0) / kBlock + blocks(0) * (at(1) / kBlock + blocks(1) * (at(2) / kBlock));
  return 64 * block + at(0) % kBlock + kBlock * (at(1) % kBlock) + kBlock * kBlock * (at(2) % kBlock);
}

CubeBox::Cube CubeBox::cube(uint32_t number) const {
  Cube cube = lo;
  uint32_t block = number / 64, in_block = number % 64;
  for (size_t a = 0; a < 3; ++a) {
    const auto blocks = static_cast<uint32_t>(size[a] / kBlock);
    cube[a] += static_cast<int32_t>(block % blocks * kBlock + in_block % kBlock);
    block /= blocks;
    in_block /= kBlock;
  }
  return cube;
}

RayTrail::RayTrail(const CubeBox& box) : box_(box), wide_(box), per_m_(1 / static_cast<double>(box.edge_m)) {
  for (size_t a = 0; a < 3; ++a) {
    wide_.lo[a] -= CubeBox::kBlock;
    wide_.size[a] += 2 * CubeBox::kBlock;
  }
  for (size_t a = 0; a < 3; ++a)
    for (CubeBox::Cube at = wide_.lo; at[a] < wide_.lo[a] + wide_.size[a]; ++at[a]) place_[a].push_back(wide_.number(at));
  passed_.resize(wide_.blocks());
}

void RayTrail::clear() {
  for (const uint32_t block : blocks_) passed_[block] = 0;
  blocks_.clear();
  left_ = {};
}

std::vector<CubesOfBlock> RayTrail::passed() const {
  std::vector<CubesOfBlock> passed;
  for (const uint32_t block : blocks_)
    if (const CubeBox::Cube first = wide_.cube(64 * block); box_.holds(first)) passed.push_back({box_.number(first) / 64, passed_[block]});
  std::sort(passed.begin(), passed.end(), [](const CubesOfBlock& a, const CubesOfBlock& b) { return a.block < b.block; });
  return passed;
}

// Signs of directions cannot be foreseen: no branch looks at one.
void RayTrail::add(const Ray& ray, double to_m) {
  constexpr double kAlmostAlong = 1e-30;  // 1/m: a ray in a plane across an axis goes so slowly along it
  std::array<double, 3> from, along, width;  // where it starts, in cubes of the wide box; its way a metre; metres it takes for a cube, below 0 downwards
  std::array<double, 3> until;               // it is past the box along an axis, m
  double enters = 0, leaves = to_m;
  for (int a = 0; a < 3; ++a) {
    const auto i = static_cast<size_t>(a);
    const double way = static_cast<double>(ray.direction[a]) * per_m_;
    from[i] = static_cast<double>(ray.origin[a]) * per_m_ - wide_.lo[i];
    along[i] = std::abs(way) < kAlmostAlong ? kAlmostAlong : way;
    width[i] = 1 / along[i];
    const double lo = (CubeBox::kBlock - from[i]) * width[i], hi = (CubeBox::kBlock + box_.size[i] - from[i]) * width[i];
    enters = std::max(enters, std::min(lo, hi));
    until[i] = std::max(lo, hi);
    leaves = std::min(leaves, until[i]);
  }
  if (enters > 0) left_ = Sides::all();
  else if (leaves < to_m)
    for (size_t i = 0; i < 3; ++i)
      if (until[i] <= leaves + static_cast<double>(box_.edge_m)) left_.add(i, along[i] > 0);  // near an edge, where rounding may tell otherwise, by both
  if (!(enters <= leaves)) return;
  uint64_t* const passed = passed_.data();
  const auto pass = [&](uint32_t number) {
    uint64_t& block = passed[number / 64];
    if (block == 0) blocks_.push_back(number / 64);
    block |= uint64_t{1} << number % 64;
  };
  // Where it is in a cube of the box, or rounding has it a hair outside: in one of those around.
  const auto cubeAt = [](double start, double way_m, double per_m) { return static_cast<ptrdiff_t>(start + way_m * per_m); };
  std::array<ptrdiff_t, 3> start;
  for (size_t i = 0; i < 3; ++i) start[i] = std::clamp<ptrdiff_t>(cubeAt(from[i], enters, along[i]), CubeBox::kBlock, CubeBox::kBlock + box_.size[i] - 1);
  pass(place_[0][static_cast<size_t>(start[0])] + place_[1][static_cast<size_t>(start[1])] + place_[2][static_cast<size_t>(start[2])]);
  // Axis by axis, the cubes that it enters through a face across that axis: no step waits for the one before. Through an edge it may go at once, as
  // what lies there is in all cubes around.
  for (size_t i = 0; i < 3; ++i) {
    const size_t j = (i + 1) % 3, k = (i + 2) % 3;
    const uint32_t *const of_i = place_[i].data(), *const of_j = place_[j].data(), *const of_k = place_[k].data();
    const double from_j = from[j], from_k = from[k], along_j = along[j], along_k = along[k], width_m = std::abs(width[i]);
    const ptrdiff_t up = along[i] > 0, step = 2 * up - 1;
    ptrdiff_t at = start[i];
    for (double way_m = (static_cast<double>(start[i] + up) - from[i]) * width[i]; way_m < leaves; way_m += width_m) {
      at += step;
      pass(of_i[at] + of_j[cubeAt(from_j, way_m, along_j)] + of_k[cubeAt(from_k, way_m, along_k)]);
    }
  }
}

}  // namespace ff::bake
