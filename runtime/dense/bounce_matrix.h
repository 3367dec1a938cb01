// A dense matrix of form factors with all bounces in it, over at most M places, that nodes enter and leave: the heart
// of the `multibounce` and `seed` solvers, on the CPU and on Vulkan. A place is a row and a column; which node holds it
// is the caller's business. Per colour channel, with C = diag(albedo): G = (I - F C)^-1 F, so that E = G M.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <span>

#include "formats/result.h"
#include "runtime/cut/local_matrix.h"

namespace ff::runtime {

inline constexpr uint32_t kMaxPlaces = 65536;
inline constexpr uint32_t kMaxBlock = 64;  // nodes that enter or leave in one step, at most

enum class Storage { kFloat32, kFloat16 };  // of the matrix; sums are always fp32

// Nodes that enter together: P, k of them. Form factors are given sparsely, both ways, because rows are sampled
// independently: F_ij A_i and F_ji A_j agree only up to sampling. All spans are the caller's and only read.
struct EnteringBlock {
  std::span<const uint32_t> places;  // k free places, 1 <= k <= kMaxBlock
  std::span<const Vec4> albedo;      // k; w is ignored
  // F_PL and F_PP: k rows. Row r is columns[row_start[r] .. row_start[r + 1]): places present or entering.
  std::span<const uint32_t> row_start;  // k + 1
  std::span<const uint32_t> columns;    // places, each at most once a row
  std::span<const float> row_values;
  // F_LP: k columns. Column c is receivers[column_start[c] .. column_start[c + 1]): places present, none that enters.
  std::span<const uint32_t> column_start;  // k + 1
  std::span<const uint32_t> receivers;
  std::span<const float> column_values;
};

// Whether every form factor of the block is finite and not negative; insert() refuses it otherwise.
inline bool hasValidFormFactors(const EnteringBlock& block) {
  const auto valid = [](float f) { return std::isfinite(f) && f >= 0; };
  return std::all_of(block.row_values.begin(), block.row_values.end(), valid) &&
         std::all_of(block.column_values.begin(), block.column_values.end(), valid);
}

struct BounceStats {
  uint64_t entered = 0, left = 0;  // nodes
  uint64_t clamped = 0;            // albedos lowered because a row sum times albedo would reach 1
  double last_update_ms = 0, last_relight_ms = 0;
  uint32_t pending_columns = 0;  // columns that still await an update
};

// One caller at a time. No call allocates after create(), errors aside.
class BounceMatrix {
 public:
  virtual ~BounceMatrix() = default;
  virtual uint32_t capacity() const = 0;  // M: places
  virtual uint64_t bytes() const = 0;     // of the matrix
  // Errors (kInvalidFile): a block whose S C is so near 1 that K = (I - S C_P)^-1 has no correct digits; the matrix is
  // then as before.
  virtual Result<void> insert(const EnteringBlock& block) = 0;
  // places: any number that are present, each once. After an error only clear() and the destructor make sense.
  virtual Result<void> remove(std::span<const uint32_t> places) = 0;
  // Forgets all nodes.
  virtual Result<void> clear() = 0;
  // An update may leave columns for later: relight() is exact all the same. Brings at most so many up to date; returns
  // how many are left. Implementations that are always up to date return 0.
  virtual Result<uint32_t> advance(uint32_t columns) = 0;
  // E = G M, W/m2: irradiance of every place from the radiosity that leaves every place without bounces. M values each;
  // free places have irradiance 0.
  virtual Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) = 0;
  // irradiance += G[:, places] difference: only some lights have changed. difference: one per place named.
  virtual Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                                      std::span<Vec4> irradiance) = 0;
  virtual BounceStats stats() const = 0;
  virtual const char* name() const = 0;  // "multibounce cpu fp16", "seed vulkan: llvmpipe ...", ...
};

struct MultibounceSettings {
  uint32_t places = 4096;
  Storage storage = Storage::kFloat32;
  bool luminance = false;   // one matrix for the mean of the channels' albedos instead of three; measured, not exact
  // The pass over the matrix that brings updates in is left to advance(), and relight() makes do with what there is.
  // Otherwise it is made before the next light, or by the update itself.
  bool time_slice = false;
  int threads = 0;          // CPU: 0 = all cores
};

}  // namespace ff::runtime
