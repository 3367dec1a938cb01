// Loops on registers of all widths that this processor has, against the same arithmetic one by one.
#include "bake/wide.h"

#include <gtest/gtest.h>

#include <bit>
#include <iostream>
#include <vector>

#include "bake/rays/sobol.h"
#include "formats/portable_math.h"

namespace ff::bake::test {
namespace {

struct Arithmetic {
  [[gnu::always_inline]] static void run(const float* u, float* result, size_t n) {
    for (size_t i = 0; i < n; ++i) {
      const auto [sine, cosine] = sineCosineOfTurn(static_cast<double>(u[i]));
      result[i] = std::sqrt(u[i]) * static_cast<float>(sine) + static_cast<float>(cosine) / (u[i] - 0.37f);
    }
  }
};

TEST(Wide, RegistersOfAllWidthsGiveTheSameBits) {
  constexpr size_t kCount = 100003;  // leaves a rest at every width
  std::vector<float> u(kCount), expected(kCount);
  for (size_t i = 0; i < kCount; ++i) {
    u[i] = static_cast<float>(unitOf(i));
    const auto [sine, cosine] = sineCosineOfTurns(static_cast<double>(u[i]));
    expected[i] = std::sqrt(u[i]) * static_cast<float>(sine) + static_cast<float>(cosine) / (u[i] - 0.37f);
  }
  using All = Wide<Arithmetic, const float*, float*, size_t>;
  const auto expectSame = [&](auto* run, const char* name) {
    std::vector<float> result(kCount);
    run(u.data(), result.data(), kCount);
    for (size_t i = 0; i < kCount; ++i) ASSERT_EQ(std::bit_cast<uint32_t>(result[i]), std::bit_cast<uint32_t>(expected[i])) << name << ", " << u[i];
  };
  expectSame(&All::on128, "128");
  if (__builtin_cpu_supports("avx2")) expectSame(&All::on256, "256");
  else std::cout << "not tried: this processor has no AVX2\n";
  if (All::widest() == &All::on512) expectSame(&All::on512, "512");
  else std::cout << "not tried: this processor has no AVX-512\n";
}

TEST(Wide, SobolPointsTogetherAreThoseOneByOne) {
  const SobolTable sobol(1000);
  const auto seeds = SobolTable::seeds(7, 12345);
  std::vector<float> u(517);
  for (uint32_t d = 0; d < 4; ++d) {
    sobol.points(300, d, seeds, u);
    for (uint32_t i = 0; i < u.size(); ++i) ASSERT_EQ(u[i], sobol.point(300 + i, seeds)[d]) << d << ", " << i;
  }
}

}  // namespace
}  // namespace ff::bake::test
