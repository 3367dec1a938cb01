// The light that fixed points of the world's surfaces show from frame to frame, whatever the cut: that of every patch near the
// observer, as its node in the cut is lit.
#pragma once
#include <cmath>
#include <span>
#include <vector>

#include "formats/read/whole_world.h"
#include "runtime/cut/local_matrix.h"
#include "tests/bench/truth.h"

namespace ff::bench {

class SurfaceLight {
 public:
  static constexpr float kNear_m = 12, kFar_m = 30;

  // Squares of W/m2, summed over patches and channels.
  struct Error {
    double off = 0, of = 0;
    double relative() const { return of > 0 ? std::sqrt(off / of) : 0; }
    Error& operator+=(const Error& more) {
      off += more.off;
      of += more.of;
      return *this;
    }
  };

  // Reads all patches; the world must outlive it. truth: what each reflects, W/m2, three a patch.
  SurfaceLight(const formats::WholeWorld& world, std::span<const double> truth);

  // radiosity: what slots reflect. Changes since the last look of the patches that were in reach then, over the mean within kFar_m; the first
  // look after forget() has none.
  void look(Vec3 observer, const LocalMatrix& matrix, std::span<const Vec4> radiosity);
  void forget() { ++look_; }  // what was seen before
  const std::vector<float>& near() const { return near_; }  // of the last look, within kNear_m
  const std::vector<float>& far() const { return far_; }    // beyond
  const Error& nearError() const { return near_error_; }    // of the last look, against the truth
  const Error& farError() const { return far_error_; }

 private:
  struct Patch {
    Vec3 centroid, albedo, truth;
  };
  struct Seen {
    Vec3 light;
    uint32_t look = 0;
  };
  const formats::WholeWorld& world_;
  std::vector<Patch> patches_;
  std::vector<Seen> seen_;
  uint32_t look_ = 1;
  std::vector<float> near_, far_;
  Error near_error_, far_error_;
};

}  // namespace ff::bench
