// The dense matrices on Vulkan against a double-precision solve of the patches that are in, over walks; each subgroup
// size that lavapipe has (see vulkan.cmake), under synchronisation validation, which must stay silent. It does not see a
// missing barrier between dispatches that write the same buffer, so results are also compared over many repetitions.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/vk_multibounce.h"
#include "runtime/dense/vk_seed.h"
#include "runtime/vulkan/context.h"
#include "tests/runtime/vulkan/validated_vulkan.h"
#include "tools/chart/walks.h"

namespace ff::runtime {
namespace {

using namespace walks;

std::vector<uint32_t> numbers(uint32_t first, uint32_t count) {
  std::vector<uint32_t> list(count);
  std::iota(list.begin(), list.end(), first);
  return list;
}

void enterAll(BounceMatrix& matrix, Placement& at, std::span<const uint32_t> patches, uint32_t block = kMaxBlock) {
  for (size_t first = 0; first < patches.size(); first += block) {
    auto r = matrix.insert(at.enter(patches.subspan(first, std::min<size_t>(block, patches.size() - first))));
    ASSERT_TRUE(r) << r.error().line();
  }
}

double errorOf(BounceMatrix& matrix, const Placement& at, uint64_t light_seed) {
  const auto source = randomLight(at.places(), light_seed);
  std::vector<Vec4> irradiance(at.places(), Vec4{7, 7, 7, 7});
  const auto r = matrix.relight(source, irradiance);
  EXPECT_TRUE(r) << (r ? "" : r.error().line());
  for (uint32_t i = 0; i < at.places(); ++i) {
    EXPECT_TRUE(std::isfinite(irradiance[i].x + irradiance[i].y + irradiance[i].z)) << i;
    if (at.patch(i) != Placement::kNone) continue;
    EXPECT_EQ(irradiance[i].x, 0) << "free place " << i;
    EXPECT_EQ(irradiance[i].y, 0) << "free place " << i;
    EXPECT_EQ(irradiance[i].z, 0) << "free place " << i;
  }
  return relativeError(irradiance, exactIrradiance(at, source));
}

// An entry of G is a sum of positive terms, found in fp32 with sums of at most a few hundred terms: relative 1e-5 leaves
// room for updates after updates (albedo 0.8 multiplies errors by up to 5). fp16 has a relative rounding of 2^-11 an
// entry, which averages out over a row, at every update anew.
double tolerance(Storage storage) { return storage == Storage::kFloat32 ? 1e-5 : 5e-3; }

class VkBounceMatrix : public ValidatedVulkan {
 protected:
  std::unique_ptr<BounceMatrix> make(MultibounceSettings settings) {
    auto m = makeVulkanMultibounce(context_, settings);
    EXPECT_TRUE(m) << (m ? "" : m.error().line());
    return m ? std::move(*m) : nullptr;
  }
  void walks(WalkKind kind, Storage storage, SceneSettings scene, uint32_t places, uint32_t block, int steps,
             bool time_slice = false) {
    const SceneRows set = makeScene(scene);
    auto matrix = make({.places = places, .storage = storage, .time_slice = time_slice});
    ASSERT_TRUE(matrix);
    Placement at(set, places);
    const uint32_t window = std::min(places, scene.patches);
    Walk walk(kind, scene.patches, window, block, 3);
    enterAll(*matrix, at, walk.present());
    for (int i = 0; i < steps; ++i) {
      const auto step = walk.next();
      auto left = matrix->remove(at.leave(step.leaving));
      ASSERT_TRUE(left) << left.error().line();
      auto entered = matrix->insert(at.enter(step.entering));
      ASSERT_TRUE(entered) << entered.error().line();
      if (i % 16 == 0) {
        EXPECT_LE(errorOf(*matrix, at, static_cast<uint64_t>(i)), tolerance(storage)) << "step " << i;
      }
    }
    EXPECT_LE(errorOf(*matrix, at, 77), tolerance(storage));
  }
};

TEST_F(VkBounceMatrix, EqualsADirectSolveForEveryStorageAndRaggedSize) {
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16})
    for (const uint32_t patches : {1u, 5u, 64u, 65u, 131u}) {
      SCOPED_TRACE(patches);
      const SceneRows set = makeScene({.patches = patches, .entries_per_row = 40, .seed = patches});
      auto matrix = make({.places = patches, .storage = storage});
      ASSERT_TRUE(matrix);
      Placement at(set, patches);
      enterAll(*matrix, at, numbers(0, patches), patches == 131 ? 64 : 17);
      EXPECT_LE(errorOf(*matrix, at, 5), tolerance(storage));
      EXPECT_GT(matrix->stats().last_update_ms, 0);
      EXPECT_GT(matrix->stats().last_relight_ms, 0);
      EXPECT_EQ(matrix->stats().entered, patches);
    }
}

TEST_F(VkBounceMatrix, TakesBlocksOfEverySizeInAnyOrder) {
  const SceneRows set = makeScene({.patches = 70, .entries_per_row = 30});
  for (const uint32_t block : {1u, 3u, 33u, 64u}) {
    auto matrix = make({.places = 70});
    ASSERT_TRUE(matrix);
    Placement at(set, 70);
    std::vector<uint32_t> order = numbers(0, 70);
    std::mt19937_64 random(block);
    for (size_t i = order.size(); i > 1; --i) std::swap(order[i - 1], order[random() % i]);
    enterAll(*matrix, at, order, block);
    EXPECT_LE(errorOf(*matrix, at, 6), 1e-5) << block;
  }
}

TEST_F(VkBounceMatrix, IsAFunctionOfTheCutAfterEveryKindOfWalk) {
  const SceneSettings scene{.patches = 200, .entries_per_row = 40};
  for (const WalkKind kind : {WalkKind::kStraight, WalkKind::kOscillation, WalkKind::kTeleports, WalkKind::kRandom})
    for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
      SCOPED_TRACE(testing::Message() << "walk " << static_cast<int>(kind) << " storage " << static_cast<int>(storage));
      walks(kind, storage, scene, 100, 8, 17);
    }
}

TEST_F(VkBounceMatrix, HoldsInClosedRoomsOfPalePaint) {
  for (const float albedo : {0.5f, 0.9f, 0.98f, 0.999f}) {
    SCOPED_TRACE(albedo);
    const SceneRows set = makeScene({.kind = SceneKind::kClosedBox, .patches = 64, .entries_per_row = 40, .albedo = albedo});
    auto matrix = make({.places = 64});
    ASSERT_TRUE(matrix);
    Placement at(set, 64);
    Walk walk(WalkKind::kRandom, 64, 64, 8, 4);
    enterAll(*matrix, at, walk.present());
    for (int i = 0; i < 50; ++i) {
      const auto step = walk.next();
      ASSERT_TRUE(matrix->remove(at.leave(step.leaving)));
      ASSERT_TRUE(matrix->insert(at.enter(step.entering)));
    }
    // The rounding of G is multiplied by up to 1 / (1 - albedo), once in what enters and once in what it passes on. At
    // 0.999 both the CPU and this are off by up to 1e-2 after some hundred swaps: fp32 has no more.
    const double kept = 1 / (1 - static_cast<double>(albedo));
    EXPECT_LE(errorOf(*matrix, at, 9), std::min(5e-2, 2e-7 * kept * kept + 5e-7));
  }
}

TEST_F(VkBounceMatrix, AgreesWithTheCpuStepByStep) {
  const SceneRows set = makeScene({.patches = 160, .entries_per_row = 40});
  for (const bool luminance : {false, true})
    for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
      const MultibounceSettings settings{.places = 90, .storage = storage, .luminance = luminance, .threads = 1};
      auto vulkan = make(settings);
      auto cpu = makeCpuMultibounce(settings);
      ASSERT_TRUE(vulkan && cpu);
      Placement at(set, 90), cpu_at(set, 90);
      Walk walk(WalkKind::kRandom, 160, 90, 13, 5);
      const auto present = walk.present();
      enterAll(*vulkan, at, present);
      enterAll(**cpu, cpu_at, present);
      for (int i = 0; i < 8; ++i) {
        const auto step = walk.next();
        ASSERT_TRUE(vulkan->remove(at.leave(step.leaving)) && (*cpu)->remove(cpu_at.leave(step.leaving)));
        ASSERT_TRUE(vulkan->insert(at.enter(step.entering)) && (*cpu)->insert(cpu_at.enter(step.entering)));
        const auto source = randomLight(90, static_cast<uint64_t>(i));
        std::vector<Vec4> a(90), b(90);
        ASSERT_TRUE(vulkan->relight(source, a) && (*cpu)->relight(source, b));
        EXPECT_LE(relativeError(a, asDouble(b)), storage == Storage::kFloat32 ? 2e-6 : 1e-3) << "step " << i;
      }
      EXPECT_EQ(vulkan->stats().entered, (*cpu)->stats().entered);
      EXPECT_EQ(vulkan->stats().left, (*cpu)->stats().left);
    }
}

TEST_F(VkBounceMatrix, IsExactWhileAnUpdateIsUnderWay) {
  const SceneSettings scene{.patches = 300, .entries_per_row = 40};
  walks(WalkKind::kRandom, Storage::kFloat32, scene, 100, 8, 17, /*time_slice=*/true);
  const SceneRows set = makeScene(scene);
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    auto matrix = make({.places = 150, .storage = storage, .time_slice = true});
    ASSERT_TRUE(matrix);
    Placement at(set, 150);
    enterAll(*matrix, at, numbers(0, 150));
    for (int round = 0; round < 4; ++round) {
      ASSERT_TRUE(matrix->remove(at.leave(numbers(10u * static_cast<uint32_t>(round), 10))));
      ASSERT_TRUE(matrix->insert(at.enter(numbers(150 + 10u * static_cast<uint32_t>(round), 10))));
      uint32_t left = matrix->stats().pending_columns;
      EXPECT_GE(left, 150u);
      while (left > 0) {
        EXPECT_LE(errorOf(*matrix, at, left), tolerance(storage)) << left << " columns left";
        auto now = matrix->advance(37);
        ASSERT_TRUE(now) << now.error().line();
        EXPECT_LT(*now, left);
        left = *now;
      }
      EXPECT_LE(errorOf(*matrix, at, 1), tolerance(storage));
    }
  }
}

TEST_F(VkBounceMatrix, AddsOnlyTheLightsThatChanged) {
  const SceneRows set = makeScene({.patches = 200, .entries_per_row = 40});
  for (const bool time_slice : {false, true})
    for (const uint32_t changed : {1u, 5u, 24u, 150u}) {
      auto matrix = make({.places = 200, .time_slice = time_slice});
      ASSERT_TRUE(matrix);
      Placement at(set, 200);
      enterAll(*matrix, at, numbers(0, 200));
      auto source = randomLight(200, 1);
      std::vector<Vec4> irradiance(200);
      ASSERT_TRUE(matrix->relight(source, irradiance));
      std::vector<uint32_t> places;
      std::vector<Vec4> difference;
      for (uint32_t i = 0; i < changed; ++i) {
        places.push_back(i * 7 % 200);
        difference.push_back({1.0f * static_cast<float>(i + 1), 2, 3, 0});
        source[places.back()].x += difference.back().x;
        source[places.back()].y += difference.back().y;
        source[places.back()].z += difference.back().z;
      }
      ASSERT_TRUE(matrix->relightChanged(places, difference, irradiance));
      EXPECT_LE(relativeError(irradiance, exactIrradiance(at, source)), 1e-5) << changed << time_slice;
    }
}

// Three products with the matrix of the mean albedo leave the third power of the colours' deviation; colours between 0.2
// and 0.8 are as far apart as these.
TEST_F(VkBounceMatrix, ALuminanceMatrixKeepsColoursNearly) {
  const SceneRows set = makeScene({.patches = 150, .entries_per_row = 40});
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    auto matrix = make({.places = 150, .storage = storage, .luminance = true});
    ASSERT_TRUE(matrix);
    Placement at(set, 150);
    enterAll(*matrix, at, numbers(0, 150));
    const double error = errorOf(*matrix, at, 3);
    EXPECT_LE(error, 0.03);
    EXPECT_GT(error, 1e-5);
    auto three = make({.places = 150, .storage = storage});
    ASSERT_TRUE(three);
    EXPECT_EQ(matrix->bytes() * 3, three->bytes());
  }
  SceneSettings grey{.patches = 150, .entries_per_row = 40, .albedo = 0.6f};
  const SceneRows grey_set = makeScene(grey);
  auto matrix = make({.places = 150, .luminance = true});
  ASSERT_TRUE(matrix);
  Placement at(grey_set, 150);
  enterAll(*matrix, at, numbers(0, 150));
  EXPECT_LE(errorOf(*matrix, at, 3), 1e-5);
}

TEST_F(VkBounceMatrix, RefusesNodesThatCatchAllLightAndStaysAsItWas) {
  // Two patches that see only each other, and lose nothing.
  std::vector<FormFactorRow> rows = makeRows({.patches = 100, .entries_per_row = 30});
  rows.push_back({{101, 1.0f + 1e-3f}});
  rows.push_back({{100, 1.0f}});
  std::vector<Vec4> albedo = makeAlbedos({.patches = 102});
  albedo[100] = albedo[101] = {0.9999f, 0.9995f, 0.5f, 0};
  const SceneRows set = makeSceneRows(rows, albedo);
  auto matrix = make({.places = 102});
  ASSERT_TRUE(matrix);
  Placement at(set, 102);
  enterAll(*matrix, at, numbers(0, 100));
  const auto refused = matrix->insert(at.enter(numbers(100, 2)));
  // Lowered to 1 - 1/4096 they keep at most so much light that K has correct digits: taken, and counted.
  if (refused) {
    EXPECT_EQ(matrix->stats().clamped, 2u);
    ASSERT_TRUE(matrix->remove(at.leave(numbers(100, 2))));
  } else {
    at.leave(numbers(100, 2));
  }
  EXPECT_LE(errorOf(*matrix, at, 4), 1e-5);
  // Form factors above 1 that make I - S C exactly singular.
  rows[100] = {{101, 2.0f}};
  rows[101] = {{100, 2.0f}};
  albedo[100] = albedo[101] = {0.5f, 0.5f, 0.5f, 0};
  const SceneRows impossible = makeSceneRows(rows, albedo);
  Placement there(impossible, 102);
  auto second = make({.places = 102});
  ASSERT_TRUE(second);
  enterAll(*second, there, numbers(0, 100));
  const auto caught = second->insert(there.enter(numbers(100, 2)));
  ASSERT_FALSE(caught);
  EXPECT_EQ(caught.error().code, ErrorCode::kInvalidFile);
  there.leave(numbers(100, 2));
  EXPECT_LE(errorOf(*second, there, 4), 1e-5);
  EXPECT_EQ(second->stats().entered, 100u);
}

TEST_F(VkBounceMatrix, RefusesNumbersThatAreNone) {
  const SceneRows set = makeScene({.patches = 10, .entries_per_row = 4});
  auto matrix = make({.places = 10});
  ASSERT_TRUE(matrix);
  Placement at(set, 10);
  EnteringBlock block = at.enter(numbers(0, 3));
  const std::vector<float> bad(block.row_values.size(), std::nanf(""));
  block.row_values = bad;
  EXPECT_FALSE(matrix->insert(block));
  EXPECT_EQ(matrix->stats().entered, 0u);
}

TEST_F(VkBounceMatrix, ForgetsAllWhenCleared) {
  const SceneRows set = makeScene({.patches = 90, .entries_per_row = 30});
  auto matrix = make({.places = 90});
  ASSERT_TRUE(matrix);
  Placement first(set, 90);
  enterAll(*matrix, first, numbers(0, 90));
  ASSERT_TRUE(matrix->clear());
  Placement second(set, 90);
  EXPECT_EQ(errorOf(*matrix, second, 1), 0);
  enterAll(*matrix, second, numbers(20, 50));
  EXPECT_LE(errorOf(*matrix, second, 1), 1e-5);
}

TEST_F(VkBounceMatrix, RefusesAMatrixThatTheDeviceCannotBind) {
  const auto m = makeVulkanMultibounce(context_, {.places = 60000});
  ASSERT_FALSE(m);
  EXPECT_EQ(m.error().code, ErrorCode::kUsage);
  EXPECT_NE(m.error().line().find("use at most"), std::string::npos) << m.error().line();
}

TEST_F(VkBounceMatrix, GivesTheSameBitsEveryTime) {
  const SceneRows set = makeScene({.patches = 200, .entries_per_row = 60});
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    std::vector<Vec4> first;
    for (int repeat = 0; repeat < 12; ++repeat) {
      auto matrix = make({.places = 130, .storage = storage});
      ASSERT_TRUE(matrix);
      Placement at(set, 130);
      Walk walk(WalkKind::kRandom, 200, 130, 20, 8);
      enterAll(*matrix, at, walk.present(), 20);
      for (int i = 0; i < 2; ++i) {
        const auto step = walk.next();
        ASSERT_TRUE(matrix->remove(at.leave(step.leaving)));
        ASSERT_TRUE(matrix->insert(at.enter(step.entering)));
      }
      std::vector<Vec4> e(130);
      ASSERT_TRUE(matrix->relight(randomLight(130, 2), e));
      if (first.empty()) first = e;
      for (uint32_t i = 0; i < 130; ++i)
        ASSERT_TRUE(e[i].x == first[i].x && e[i].y == first[i].y && e[i].z == first[i].z) << "place " << i;
    }
  }
}

// Both round the same numbers to fp16 at the same steps, of sums that differ in the order of their terms: now and then
// one of two neighbours of fp16, 2^-11 apart, is taken. So they agree far better than either agrees with the truth.
TEST_F(VkBounceMatrix, TheSeedAgreesWithTheCpuStepByStep) {
  const SceneRows set = makeScene({.patches = 160, .entries_per_row = 40});
  for (const uint32_t places : {1u, 17u, 90u, 129u}) {
    SCOPED_TRACE(places);
    auto vulkan = makeVulkanSeed(context_, {.places = places});
    auto cpu = makeCpuSeed({.places = places, .threads = 1});
    ASSERT_TRUE(vulkan && cpu);
    Placement at(set, places), cpu_at(set, places);
    Walk walk(WalkKind::kRandom, 160, places, std::min(places, 7u), 5);
    const auto present = walk.present();
    enterAll(**vulkan, at, present);
    enterAll(**cpu, cpu_at, present);
    for (int i = 0; i < 6; ++i) {
      const auto step = walk.next();
      ASSERT_TRUE((*vulkan)->remove(at.leave(step.leaving)) && (*cpu)->remove(cpu_at.leave(step.leaving)));
      ASSERT_TRUE((*vulkan)->insert(at.enter(step.entering)) && (*cpu)->insert(cpu_at.enter(step.entering)));
      const auto source = randomLight(places, static_cast<uint64_t>(i));
      std::vector<Vec4> a(places), b(places);
      ASSERT_TRUE((*vulkan)->relight(source, a) && (*cpu)->relight(source, b));
      EXPECT_LE(relativeError(a, asDouble(b)), 5e-5) << "step " << i;
      const std::vector<uint32_t> some = numbers(0, (places + 1) / 2);
      const std::vector<Vec4> difference(some.size(), Vec4{1, 2, 3, 0});
      ASSERT_TRUE((*vulkan)->relightChanged(some, difference, a) && (*cpu)->relightChanged(some, difference, b));
      EXPECT_LE(relativeError(a, asDouble(b)), 5e-5) << "step " << i;
    }
    EXPECT_EQ((*vulkan)->stats().entered, (*cpu)->stats().entered);
    EXPECT_GT((*vulkan)->stats().last_update_ms, 0);
    ASSERT_TRUE((*vulkan)->clear());
    std::vector<Vec4> dark(places, Vec4{1, 1, 1, 0});
    ASSERT_TRUE((*vulkan)->relight(randomLight(places, 1), dark));
    for (const Vec4& e : dark) EXPECT_EQ(e.x + e.y + e.z, 0);
  }
}

TEST_F(VkBounceMatrix, PlainLocalRadiosityAgreesWithTheCpu) {
  const SceneRows set = makeScene({.patches = 160, .entries_per_row = 40});
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16})
    for (const int bounces : {1, 2, 3, 8}) {
      const MultibounceSettings settings{.places = 101, .storage = storage, .threads = 1};
      auto vulkan = makeVulkanPlainLocal(context_, settings, bounces);
      auto cpu = makeCpuPlainLocal(settings, bounces);
      ASSERT_TRUE(vulkan && cpu);
      Placement at(set, 101), cpu_at(set, 101);
      Walk walk(WalkKind::kRandom, 160, 101, 9, 5);
      const auto present = walk.present();
      enterAll(**vulkan, at, present);
      enterAll(**cpu, cpu_at, present);
      for (int i = 0; i < 3; ++i) {
        const auto step = walk.next();
        ASSERT_TRUE((*vulkan)->remove(at.leave(step.leaving)) && (*cpu)->remove(cpu_at.leave(step.leaving)));
        ASSERT_TRUE((*vulkan)->insert(at.enter(step.entering)) && (*cpu)->insert(cpu_at.enter(step.entering)));
        const auto source = randomLight(101, static_cast<uint64_t>(i));
        std::vector<Vec4> a(101), b(101);
        ASSERT_TRUE((*vulkan)->relight(source, a) && (*cpu)->relight(source, b));
        // The same stored numbers; sums of at most 101 positive terms, bounce by bounce.
        EXPECT_LE(relativeError(a, asDouble(b)), 2e-6) << bounces << " bounces, step " << i;
      }
    }
}

TEST_F(VkBounceMatrix, TheSeedAtItsLargestIsWhatEveryDeviceCanBind) {
  auto largest = makeVulkanSeed(context_, {.places = 4096});
  ASSERT_TRUE(largest) << largest.error().line();
  EXPECT_EQ((*largest)->bytes(), uint64_t{128} << 20);
  const auto larger = makeVulkanSeed(context_, {.places = 60000});
  ASSERT_FALSE(larger);
  EXPECT_EQ(larger.error().code, ErrorCode::kUsage);
}

}  // namespace
}  // namespace ff::runtime
