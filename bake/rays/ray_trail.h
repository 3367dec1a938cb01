// Where rays have been: the cubes of cells that they passed through. What stands elsewhere had no part in what they found, so that
// this tells which rays an edit has to cast again.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bake/rays/triangle_hit.h"

namespace ff::bake {

// A box of cubes, which are counted from the grid's origin; blocks of 4 x 4 x 4 cubes are counted from there, too, and are whole in it.
struct CubeBox {
  using Cube = std::array<int32_t, 3>;
  static constexpr int32_t kBlock = 4;  // cubes a side: a bit each in 64
  float edge_m = 1;                     // of a cube
  Cube lo{}, size{};                    // multiples of kBlock
  size_t count() const { return static_cast<size_t>(size[0]) * static_cast<size_t>(size[1]) * static_cast<size_t>(size[2]); }
  size_t blocks() const { return count() / 64; }
  bool holds(const Cube& cube) const;
  uint32_t number(const Cube& cube) const;  // of one that it holds, 0 to count() - 1: 64 times its block's and its bit there
  Cube cube(uint32_t number) const;
  friend bool operator==(const CubeBox&, const CubeBox&) = default;
};

// Some cubes of a block.
struct CubesOfBlock {
  uint32_t block = 0;  // number of its first cube / 64
  uint64_t cubes = 0;  // a bit each
};

// The sides of a box by which rays left it, a bit each: what a box that is larger on other sides alone holds beyond it, they cannot have met.
class Sides {
 public:
  static constexpr uint8_t kAll = 63;
  Sides() = default;
  explicit Sides(uint8_t bits) : bits_(bits) {}
  static Sides all() { return Sides(kAll); }
  void add(size_t axis, bool upper) { bits_ |= static_cast<uint8_t>(1 << (2 * axis + upper)); }
  bool has(size_t axis, bool upper) const { return bits_ >> (2 * axis + upper) & 1; }
  bool none() const { return bits_ == 0; }
  uint8_t bits() const { return bits_; }

 private:
  uint8_t bits_ = 0;
};

// Not thread-safe. Memory: a bit a cube of the box.
class RayTrail {
 public:
  // At most 2^32 - 1 cubes, with a block around them.
  explicit RayTrail(const CubeBox& box);
  // A ray that went so far; infinite: out of the box. Marches from cube to cube: John Amanatides, Andrew Woo. A fast voxel traversal algorithm
  // for ray tracing. Eurographics 1987.
  void add(const Ray& ray, double to_m);
  void clear();
  // The cubes passed through since, by block, ascending.
  std::vector<CubesOfBlock> passed() const;
  // By which sides rays have left the box; all of them where one started outside.
  Sides left() const { return left_; }

 private:
  CubeBox box_, wide_;                            // the box, and a block more on each side, for rays that rounding takes there
  double per_m_;                                  // cubes
  std::array<std::vector<uint32_t>, 3> place_;    // what a coordinate in the wide box adds to the number of a cube
  std::vector<uint64_t> passed_;                  // by block of the wide box
  std::vector<uint32_t> blocks_;                  // those that are not 0
  Sides left_;
};

}  // namespace ff::bake
