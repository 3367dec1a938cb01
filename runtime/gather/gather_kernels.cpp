#include "runtime/gather/gather_kernels.h"

#include "runtime/solver/sound_light.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace ff::runtime {

bool gatherPortable(const GatherJob& job, uint32_t begin, uint32_t end) {
  bool sound = true;
  for (uint32_t i = begin; i < end; ++i) {
    const uint32_t slot = job.leaves[i];
    Float4 even{}, odd{};  // two chains, so that an addition need not wait for the one before
    uint32_t k = job.row_start[slot];
    const uint32_t last = k + job.row_entries[slot];
    for (; k + 2 <= last; k += 2) {
      const uint32_t a = job.entries[k], b = job.entries[k + 1];
      even += asFloat4(job.from[slotOfEntry(a)]) * static_cast<float>(countOfEntry(a));
      odd += asFloat4(job.from[slotOfEntry(b)]) * static_cast<float>(countOfEntry(b));
    }
    if (k < last) {
      const uint32_t a = job.entries[k];
      even += asFloat4(job.from[slotOfEntry(a)]) * static_cast<float>(countOfEntry(a));
    }
    asFloat4(job.to[slot]) = asFloat4(job.source[slot]) + asFloat4(job.albedo[slot]) * job.row_scale[slot] * (even + odd);
    sound &= isSound(job.to[slot]);
  }
  return sound;
}

void refineSlots(const LocalMatrix& matrix, Vec4* values, uint32_t begin, uint32_t end) {
  for (uint32_t r = begin; r < end; ++r) {
    Float4 mean{};
    matrix.forEachChild(matrix.refined[r], [&](uint32_t c) { mean += asFloat4(values[c]) * matrix.child_weight[c]; });
    asFloat4(values[matrix.refined[r].slot]) = mean;
  }
}

#if defined(__x86_64__)
namespace {

// Radiosity of the columns of two entries, side by side.
__attribute__((target("avx2,fma"))) inline __m256 loadPair(const Vec4* from, uint32_t a, uint32_t b) {
  const __m128 low = _mm_loadu_ps(&from[slotOfEntry(a)].x);
  return _mm256_insertf128_ps(_mm256_castps128_ps256(low), _mm_loadu_ps(&from[slotOfEntry(b)].x), 1);
}

__attribute__((target("avx2,fma"))) bool gatherRowsAvx2(const GatherJob& job, uint32_t begin, uint32_t end) {
  const __m128 sign = _mm_set1_ps(-0.0f), most = _mm_set1_ps(shaders::kMaxRadiosity);
  __m128 sound = _mm_cmpeq_ps(most, most);
  const __m256i count_mask = _mm256_set1_epi32(shaders::kCountMask);
  const Vec4* const from = job.from;
  for (uint32_t i = begin; i < end; ++i) {
    const uint32_t slot = job.leaves[i];
    __m256 even = _mm256_setzero_ps(), odd = even;
    const uint32_t* e = job.entries + job.row_start[slot];
    const uint32_t* const last = e + job.row_entries[slot];
    for (; e < last; e += kRowPadding) {  // rows are padded: no remainder
      const __m256i packed = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(e));
      const __m256 counts = _mm256_cvtepi32_ps(_mm256_and_si256(packed, count_mask));
      // Entry k beside entry k + 4, so that counts are spread within their half: a shuffle across halves takes longer.
      even = _mm256_fmadd_ps(loadPair(from, e[0], e[4]), _mm256_permute_ps(counts, 0x00), even);
      odd = _mm256_fmadd_ps(loadPair(from, e[1], e[5]), _mm256_permute_ps(counts, 0x55), odd);
      even = _mm256_fmadd_ps(loadPair(from, e[2], e[6]), _mm256_permute_ps(counts, 0xaa), even);
      odd = _mm256_fmadd_ps(loadPair(from, e[3], e[7]), _mm256_permute_ps(counts, 0xff), odd);
    }
    even = _mm256_add_ps(even, odd);
    const __m128 sum = _mm_add_ps(_mm256_castps256_ps128(even), _mm256_extractf128_ps(even, 1));
    const __m128 reflected = _mm_mul_ps(sum, _mm_mul_ps(_mm_loadu_ps(&job.albedo[slot].x), _mm_set1_ps(job.row_scale[slot])));
    const __m128 light = _mm_add_ps(_mm_loadu_ps(&job.source[slot].x), reflected);
    sound = _mm_and_ps(sound, _mm_cmple_ps(_mm_andnot_ps(sign, light), most));  // false for NaN
    _mm_storeu_ps(&job.to[slot].x, light);
  }
  return _mm_movemask_ps(sound) == 0xf;
}

}  // namespace

GatherKernel gatherAvx2() {
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? gatherRowsAvx2 : nullptr;
}
#else
GatherKernel gatherAvx2() { return nullptr; }
#endif

}  // namespace ff::runtime
