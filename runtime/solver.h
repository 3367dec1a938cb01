// B = M + albedo * F B over the slots of a local matrix; one interface for the CPU and Vulkan.
// M is the radiosity that leaves a slot without bounces among slots: emission + albedo * (direct + sky irradiance).
#pragma once
#include <memory>
#include <span>

#include "formats/result.h"
#include "runtime/local_matrix.h"

namespace ff::runtime {

class Solver {
 public:
  virtual ~Solver() = default;
  // Takes a new matrix and the radiosity to start from (one per slot; empty: start from zero). The matrix is kept.
  virtual Result<void> setMatrix(std::shared_ptr<const LocalMatrix> matrix, std::span<const Vec4> warm_start) = 0;
  // M per slot, W/m2. Refined slots' values are ignored.
  virtual Result<void> setSource(std::span<const Vec4> source) = 0;
  // k Jacobi iterations: for leaves B <- M + albedo * F B, then refined slots <- mean of their children.
  virtual Result<void> iterate(int k) = 0;
  // Copies the radiosity of every slot, W/m2.
  virtual Result<void> radiosity(std::span<Vec4> out) = 0;
  // Time of the last iterate(), ms, on the clock of the device that ran it.
  virtual double lastMs() const = 0;
  virtual const char* name() const = 0;  // "cpu", "vulkan: llvmpipe ..."
};

// threads: 0 = all cores.
std::unique_ptr<Solver> makeCpuGather(int threads = 0);

}  // namespace ff::runtime
