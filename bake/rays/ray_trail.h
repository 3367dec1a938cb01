// Where rays have been: the cubes of cells that they passed through. What stands elsewhere had no part in what they found, so that
// this tells which rays an edit has to cast again.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bake/rays/triangle_hit.h"

namespace ff::bake {

// A box of cubes, which are counted from the grid's origin.
struct CubeBox {
  using Cube = std::array<int32_t, 3>;
  float edge_m = 1;  // of a cube
  Cube lo{}, size{};
  size_t count() const { return static_cast<size_t>(size[0]) * static_cast<size_t>(size[1]) * static_cast<size_t>(size[2]); }
  bool holds(const Cube& cube) const;
  uint32_t number(const Cube& cube) const;  // of one that it holds: 0 to count() - 1
  Cube cube(uint32_t number) const;
  friend bool operator==(const CubeBox&, const CubeBox&) = default;
};

// Not thread-safe. Memory: a bit a cube of the box.
class RayTrail {
 public:
  // At most 2^32 - 1 cubes.
  explicit RayTrail(const CubeBox& box);
  // A ray that went so far; infinite: out of the box. Marches from cube to cube: John Amanatides, Andrew Woo. A fast voxel traversal algorithm
  // for ray tracing. Eurographics 1987.
  void add(const Ray& ray, double to_m);
  void clear();
  // Numbers of the cubes passed through since, ascending.
  std::vector<uint32_t> cubes() const;
  // Whether a ray was outside the box.
  bool left() const { return left_; }

 private:
  void pass(size_t place);

  CubeBox box_;
  double per_m_;                  // cubes
  std::array<size_t, 3> stride_;  // of places: the box with a cube more on each side, for rays that rounding takes there
  std::vector<uint64_t> passed_;  // a bit a place
  std::vector<size_t> places_;    // those set
  bool left_ = false;
};

}  // namespace ff::bake
