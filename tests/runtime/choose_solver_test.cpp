#include "runtime/choose_solver.h"

#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/hand_made.h"
#include "tests/support/random_world.h"

namespace ff::runtime {
namespace {

// n leaves that each see `seen` others; the count says how much of a row of 1000 stays inside.
LocalMatrix room(uint32_t n, uint32_t seen, uint32_t kept_of_1000, float albedo) {
  LocalMatrix m;
  m.albedo.assign(n, {albedo, albedo, albedo, 0});
  m.row_scale.assign(n, 1e-3f);
  m.area_m2.assign(n, 1);
  m.leaf.assign(n, 1);
  m.row_start.push_back(0);
  for (uint32_t i = 0; i < n; ++i) {
    for (uint32_t k = 1; k <= seen; ++k) m.entries.push_back(packEntry((i + k) % n, kept_of_1000 / seen));
    m.row_start.push_back(static_cast<uint32_t>(m.entries.size()));
  }
  finishByHand(m);
  return m;
}

class Recommendation : public ::testing::Test {
 protected:
  Result<std::optional<SolverChoice>> read(const std::string& json) {
    std::ofstream(folder_.file("town.settings.json")) << json;
    return readRecommendation(folder_.file("town.ffm"));
  }
  formats::TemporaryFolder folder_;
};

TEST_F(Recommendation, IsNothingWhereNoneWasStored) {
  const auto none = readRecommendation(folder_.file("town.ffm"));
  ASSERT_TRUE(none);
  EXPECT_FALSE(none->has_value());
  EXPECT_EQ(settingsPath("a/b.c/town.ffm"), "a/b.c/town.settings.json");
  EXPECT_EQ(settingsPath("a/b.c/town"), "a/b.c/town.settings.json");
}

TEST_F(Recommendation, IsWhatTheFileSaysAndIgnoresWhatItDoesNotKnow) {
  const auto choice = read(R"({"solver": "multibounce", "storage": "fp16", "luminance": true, "places": 2048,
                               "iterations": 2, "radius_m": 10.5, "growth": 2, "max_patches": 3000,
                               "measured_by": {"version": 7}})");
  ASSERT_TRUE(choice) << choice.error().line();
  ASSERT_TRUE(choice->has_value());
  EXPECT_EQ((**choice).kind, SolverKind::kMultibounce);
  EXPECT_EQ((**choice).storage, Storage::kFloat16);
  EXPECT_TRUE((**choice).luminance);
  EXPECT_EQ((**choice).places, 2048u);
  EXPECT_EQ((**choice).iterations, 2);
  EXPECT_EQ((**choice).radius_m, 10.5f);
  EXPECT_EQ((**choice).growth, 2.0f);
  EXPECT_EQ((**choice).max_patches, 3000u);
  const auto least = read(R"({"solver": "gather"})");
  ASSERT_TRUE(least && least->has_value());
  EXPECT_EQ((**least).kind, SolverKind::kGather);
  EXPECT_FALSE((**least).radius_m || (**least).growth || (**least).max_patches);
}

TEST_F(Recommendation, ThatMakesNoSenseIsRefusedByName) {
  const std::pair<const char*, const char*> wrong[] = {{"", ""},
                                                       {"[1, 2]", ""},
                                                       {"{\"solver\": ", ""},
                                                       {"{}", "solver"},
                                                       {R"({"solver": "fastest"})", "solver"},
                                                       {R"({"solver": 3})", "solver"},
                                                       {R"({"solver": "gather", "storage": "fp8"})", "storage"},
                                                       {R"({"solver": "gather", "luminance": 1})", "luminance"},
                                                       {R"({"solver": "gather", "places": 0})", "places"},
                                                       {R"({"solver": "gather", "places": 1e9})", "places"},
                                                       {R"({"solver": "gather", "iterations": -1})", "iterations"},
                                                       {R"({"solver": "gather", "radius_m": 0})", "radius_m"},
                                                       {R"({"solver": "gather", "radius_m": 1e300})", "radius_m"},
                                                       {R"({"solver": "gather", "radius_m": "12"})", "radius_m"},
                                                       {R"({"solver": "gather", "growth": 0.9})", "growth"},
                                                       {R"({"solver": "gather", "growth": null})", "growth"},
                                                       {R"({"solver": "gather", "max_patches": 0})", "max_patches"},
                                                       {R"({"solver": "gather", "max_patches": 4294967296})", "max_patches"}};
  for (const auto& [json, place] : wrong) {
    const auto refused = read(json);
    ASSERT_FALSE(refused) << json;
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalidFile);
    EXPECT_EQ(refused.error().place, place);
    EXPECT_NE(refused.error().file.find("town.settings.json"), std::string::npos);
  }
}

TEST(ChooseSolver, TakesTheDenseMatrixOnlyWhereItReadsLessThanTheIterations) {
  // 300 leaves: 1.1 MB dense. White and closed: 458 iterations over 0.12 MB of rows.
  EXPECT_EQ(chooseSolver(room(300, 100, 1000, 0.99f)).kind, SolverKind::kMultibounce);
  // The same, open and dark: 3 iterations.
  EXPECT_EQ(chooseSolver(room(300, 100, 500, 0.4f)).kind, SolverKind::kGather);
  // Everyone sees nearly everyone: 7 iterations over 0.3 MB.
  EXPECT_EQ(chooseSolver(room(300, 250, 1000, 0.5f)).kind, SolverKind::kMultibounce);
  // Closed and white, but too many.
  EXPECT_EQ(chooseSolver(room(kMaxDenseLeaves + 1, 4, 1000, 0.9999f)).kind, SolverKind::kGather);
  EXPECT_EQ(chooseSolver(room(300, 100, 1000, 0)).kind, SolverKind::kGather);
  EXPECT_EQ(chooseSolver(LocalMatrix{}).kind, SolverKind::kGather);
  EXPECT_NE(chooseSolver(room(300, 100, 1000, 0.99f)).why.find("300 leaves"), std::string::npos);
}

}  // namespace
}  // namespace ff::runtime
