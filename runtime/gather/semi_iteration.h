// The pace of Solver::approach() by sparse rows: the Chebyshev semi-iteration (Golub and Varga. "Chebyshev
// semi-iterative methods, successive overrelaxation iterative methods, and second order Richardson iterative methods."
// 1961), for rooms that keep their light: where Jacobi shrinks the error by a factor s a step, it needs about the
// square root of the steps. It asks for real eigenvalues between -s and s; those of albedo * F are real by reciprocity,
// but for what sampling leaves.
//
// A step goes on from the values of two steps ago, omega times as far as Jacobi's: B_k+1 = B_k-1 + omega (M + C F B_k -
// B_k-1), and no value falls below its source, where no solution does. Two of Jacobi's steps tell how slowly light
// decays (from below: the largest of several calls is taken); the second is the first of the semi-iteration.
#pragma once
#include <algorithm>

namespace ff::runtime {

class SemiIteration {
 public:
  // The light or the matrix is another one.
  void forget() { *this = {}; }
  // Whether k steps should begin with two that are told to learn().
  bool suits(int k) const { return k >= kFewestSteps && may_; }
  // Norms of the changes by the first two steps of a call.
  void learn(double first, double second) {
    if (last_first_ >= 0 && first > last_first_) may_ = false;  // it made matters worse
    last_first_ = first;
    if (first > 0) decay_ = std::max(decay_, std::min(second / first, kMaxDecay));
    omega_ = 2;
  }
  // Of the next step; 1: Jacobi's.
  float omega() {
    if (!may_ || decay_ < kSlowDecay) return 1;
    omega_ = 1 / (1 - decay_ * decay_ * omega_ / 4);
    return static_cast<float>(omega_);
  }

 private:
  static constexpr int kFewestSteps = 4;     // else they are Jacobi's
  static constexpr double kSlowDecay = 0.6;  // the same, below it
  static constexpr double kMaxDecay = 0.9999;
  double decay_ = 0;        // of the change from step to step, under this light
  double last_first_ = -1;  // the first change of the last call; -1: none
  double omega_ = 2;
  bool may_ = true;
};

}  // namespace ff::runtime
