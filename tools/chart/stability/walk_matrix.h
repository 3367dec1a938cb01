// The patches of a walk (walks.h) as the sparse solvers take them, and the direct solution of their light.
#pragma once
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "tools/chart/walks.h"

namespace ff::chart {

inline constexpr uint32_t kWalkQuanta = 8192;   // a power of two: count / Q is exact in single precision

// The same rows as counts over kWalkQuanta, at least 1 an entry; a row's sum stays within half a count of what it was.
std::vector<walks::FormFactorRow> quantised(std::span<const walks::FormFactorRow> rows);

// makeScene (walks.h) with quantised rows: what every solver computes with is the same to the last bit.
walks::SceneRows quantisedScene(const walks::SceneSettings& settings);

// A local matrix of one level whose slots are the scene's patches; those that are present are its leaves, each a tile.
class WalkMatrix {
 public:
  explicit WalkMatrix(const walks::SceneRows& set);
  // present: ascending. What has changed since the last call is change(); a patch that left and came back is in both of
  // its lists.
  void set(std::span<const uint32_t> present, std::span<const uint32_t> left, std::span<const uint32_t> entered);
  const runtime::LocalMatrix& matrix() const { return matrix_; }
  const runtime::MatrixChange& change() const { return change_; }

 private:
  const walks::SceneRows& set_;
  std::vector<uint8_t> in_;
  runtime::LocalMatrix matrix_;
  runtime::MatrixChange change_;
};

// Reflected radiosity rho E of every patch among those present, double precision; light: M by patch. Up to 512 patches
// by elimination, which does not care how near to 1 the albedos are; above by iteration to 1e-13.
std::vector<walks::Rgb> exactReflected(const walks::SceneRows& set, std::span<const uint32_t> present,
                                         std::span<const runtime::Vec4> light);

// ||a - b|| / ||b|| over the patches present; infinity where a is not finite.
double relativeDifference(std::span<const walks::Rgb> a, std::span<const walks::Rgb> b,
                          std::span<const uint32_t> present);

}  // namespace ff::chart
