// The matrices of `multibounce` on the CPU, one a colour channel, and their exact block updates.
//
// With P the nodes that enter and L those there (Schur complement of I - F C, one matrix per colour channel):
//   U = F_LP + G C F_LP, V = F_PL + F_PL C G, S = F_PP + F_PL C U, K = (I - S C_P)^-1,
//   G_PP = K S, G_LP = U (I - C_P S)^-1, and G_LL += (U C_P) W, G_PL = W with W = K V.
// Lowering albedos of Q by -D (leaving is lowering to zero): G += G_LQ D (I - G_QQ D)^-1 G_QL.
// Either way the matrix changes by one product of a tall and a wide matrix. These two factors are kept, G = stored +
// tall wide, and updates go on from that sum: those that come next add their own columns and rows to the factors, until
// a pass over the matrix folds in up to kMaxRank of them at once. So a block that leaves and one that enters cost one
// pass, and so do a hundred nodes one by one. (Delayed updates: McDaniel, D'Azevedo, Li, Wong and Kent. "Delayed Slater
// determinant update algorithms for high efficiency quantum Monte Carlo." 2017.)
//
// U and V follow the sparsity of the block (about 100 entries a node). Cost follows the highest place in use.
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/dense/bounce_kernels.h"
#include "runtime/dense/page_memory.h"
#include "runtime/dense/small_inverse.h"
#include "runtime/solver/worker_pool.h"

namespace ff::runtime {

// One caller at a time. No call allocates.
template <class Element>
class BouncePlanes {
 public:
  // channels: 1 or 3. Rows and columns of free places are zero.
  BouncePlanes(uint32_t places, uint32_t channels, WorkerPool& pool);
  bool allocated() const;  // false: too little memory, and nothing else may be called
  uint64_t bytes() const { return uint64_t{stride_} * rows_ * sizeof(Element) * planes_.size(); }
  uint32_t channels() const { return static_cast<uint32_t>(planes_.size()); }

  float albedo(uint32_t channel, uint32_t place) const { return planes_[channel].albedo[place]; }
  void setAlbedo(uint32_t channel, uint32_t place, float albedo) { planes_[channel].albedo[place] = albedo; }

  // Room for places below `used`; to be called before anything else names them. Lower than before: those above are
  // free; this takes effect when nothing is pending.
  void use(uint32_t used);
  // The nodes' albedos are set. False where light would be multiplied by more than the storage can carry; then nothing
  // has changed.
  bool enter(const EnteringBlock& block);
  // Albedos of at most kMaxBlock places have changed by change[channel][i], or, with `leave`, change to 0 as their rows
  // and columns do. False where the matrix has lost its precision: with `leave` it is then of no use.
  using Change = std::array<std::array<double, kMaxBlock>, 3>;
  bool change(std::span<const uint32_t> places, const Change& change, bool leave);
  // Folds the factors into so many more columns; returns how many are left.
  uint32_t fold(uint32_t columns);
  uint32_t pendingColumns() const { return rank_ > 0 ? used_ - frontier_ : 0; }
  void clear();

  // out[c] = G_c times the columns named, c below 3: a single matrix is multiplied by all three lights at once. Rows up
  // to the highest place in use are written.
  void multiply(std::span<const uint32_t> columns, const float* const factors[3], float* const out[3]);

 private:
  struct Plane {
    PageMemory<Element> matrix;
    std::vector<float> albedo;  // per place, 0 where free
    std::vector<float> tall;    // rank_ columns, by panelIndex()
    std::vector<float> wide;    // rank_ values a column, kFactorStride apart
    std::vector<float> rows;    // V, or rows of G, as `wide`
    std::vector<float> left;    // kMaxBlock rows by at most kMaxRank, as `tall`
    std::vector<float> right;   // at most kMaxRank by kMaxBlock columns, as `wide`
    SmallMatrix s, k, work;
    double carried[kMaxBlock];  // sums of the rows of what S has from the matrix
    bool solved = false;
  };
  size_t number(const Plane& p) const { return static_cast<size_t>(&p - planes_.data()); }
  uint32_t usedRows() const;
  template <class Task>
  void forParts(uint32_t parts, Task&& task);
  template <class Task>
  void forRows(Task&& task);
  void makeRoom(uint32_t k);
  void gather(const EnteringBlock& block);
  void solve(const EnteringBlock& block);
  bool trusted(const Plane& p, uint32_t k) const;
  void writeColumns(std::span<const uint32_t> places);
  void addPendingToTall(Plane& p, uint32_t begin, uint32_t end, uint32_t k);
  void addPendingToRows(uint32_t k);
  void makeWide(uint32_t k);

  WorkerPool& pool_;
  BounceKernels<Element> kernels_ = bounceKernels<Element>();
  decltype(BounceKernels<float>::addProduct) product_ = bounceKernels<float>().addProduct;
  uint32_t rows_;
  size_t stride_;
  std::vector<Plane> planes_;
  std::vector<std::vector<float>> scratch_;  // one a thread
  std::vector<std::atomic_flag> scratch_taken_;
  std::vector<uint8_t> block_used_;
  std::vector<uint32_t> blocks_;
  std::vector<uint16_t> order_;  // place to number in the entering block
  std::vector<float> partial_;   // per chunk of columns: three sums of all rows
  std::array<float, kMaxRank> pending_light_[3];
  uint32_t used_ = 0, wanted_ = 0;  // one past the highest place in use; with nothing pending they are the same
  uint32_t rank_ = 0;               // columns of `tall` that are not in the matrix yet
  uint32_t frontier_ = 0;           // columns before it have them
};

extern template class BouncePlanes<float>;
extern template class BouncePlanes<Half>;

}  // namespace ff::runtime
