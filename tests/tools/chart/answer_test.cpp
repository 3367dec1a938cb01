#include "tools/chart/answer.h"

#include <gtest/gtest.h>

#include <fstream>
#include <limits>

#include "runtime/choose_solver.h"
#include "tests/support/random_world.h"
#include "tools/chart/page/front.h"
#include "tools/chart/page/page.h"
#include "tools/chart/page/setting_charts.h"

namespace ff::chart {
namespace {

constexpr double kAny = std::numeric_limits<double>::infinity();

Setting setting(const char* name, double ms, double mib, double sun, double lamps) {
  Setting s;
  s.name = name;
  s.varies = "knob";
  s.knobs = {{"rays", "4096"}};
  s.relight_ms = {ms, 0.01};
  s.memory_bytes = mib * 1048576;
  s.accuracy = {{"sun", {sun, 0.001}}, {"lamps", {lamps, 0.001}}};
  s.run.solver = "gather";
  return s;
}

// By worst light: default 4 % 2 ms, fast 8 % 1 ms, slow 1 % 9 ms, beaten 5 % 3 ms, and two that lack a figure.
Report sample() {
  Report r;
  r.settings = {setting("default", 2, 64, 0.03, 0.04),        setting("fast", 1, 32, 0.02, 0.08),
                setting("slow", 9, 16, 0.01, 0.01),           setting("beaten", 3, 8, 0.05, 0.01),
                setting("untimed", kNotMeasured, 1, 0.001, 0.001), setting("half", 0.1, 1, 0.001, kNotMeasured)};
  r.settings[0].is_default = true;
  r.settings[0].varies = "";
  return r;
}

TEST(Front, IsWhatNothingBeatsInBoth) {
  const Report r = sample();
  EXPECT_EQ(front(r, "", Cost::kRelightMs), (std::vector<size_t>{1, 0, 2}));
  EXPECT_EQ(front(r, "sun", Cost::kRelightMs), (std::vector<size_t>{5}));
  EXPECT_EQ(front(r, "lamps", Cost::kRelightMs), (std::vector<size_t>{1, 0, 3}));  // slow: no better than beaten there
  EXPECT_EQ(front(r, "", Cost::kMemoryMiB), (std::vector<size_t>{4}));
  EXPECT_TRUE(front(r, "moon", Cost::kRelightMs).empty());
  EXPECT_TRUE(front(r, "", Cost::kDiskMiB).empty());
  EXPECT_TRUE(front({}, "", Cost::kRelightMs).empty());
}

TEST(Front, HoldsAllOfEqualFiguresButNotWhatIsWorseInOne) {
  Report r;
  r.settings = {setting("a", 2, 1, 0.02, 0.02), setting("b", 1, 1, 0.03, 0.03), setting("same as a", 2, 1, 0.02, 0.02),
                setting("slower than a", 3, 1, 0.02, 0.02), setting("less accurate than b", 1, 1, 0.04, 0.04)};
  EXPECT_EQ(front(r, "", Cost::kRelightMs), (std::vector<size_t>{1, 0, 2}));
  r.settings[4].on_front = true;
  markFront(r, "");
  std::vector<bool> marked;
  for (const Setting& s : r.settings) marked.push_back(s.on_front);
  EXPECT_EQ(marked, (std::vector<bool>{true, true, true, false, false}));
}

TEST(Answer, TheCheapestWithinAnErrorCountsTheWorstLight) {
  const Report r = sample();
  EXPECT_EQ(cheapestWithin(r, 0.5).setting, 1u);
  EXPECT_EQ(cheapestWithin(r, 0.08).setting, 1u);
  EXPECT_EQ(cheapestWithin(r, 0.0799).setting, 0u);
  EXPECT_EQ(cheapestWithin(r, 0.03).setting, 2u);
  EXPECT_EQ(cheapestWithin(r, 0.04).line, "default: 4.00 \u00b1 0.10 % (lamps), 2.00 \u00b1 0.01 ms, 64 MiB");
  const Answer none = cheapestWithin(r, 0.005);
  EXPECT_FALSE(none.setting);
  EXPECT_NE(none.line.find("is within 0.500 %"), std::string::npos) << none.line;
  EXPECT_NE(none.line.find("nearest is slow: 1.00"), std::string::npos) << none.line;
  EXPECT_EQ(none.line.find('\n'), std::string::npos);
  const Answer empty = cheapestWithin({}, 0.1);
  EXPECT_FALSE(empty.setting);
  EXPECT_NE(empty.line, "");
}

TEST(Answer, EquallyFastSettingsAreToldApartByMemory) {
  Report r;
  r.settings = {setting("unknown", 1, kNotMeasured, 0.01, 0.01), setting("large", 1, 9, 0.001, 0.001), setting("small", 1, 3, 0.02, 0.02)};
  EXPECT_EQ(cheapestWithin(r, 0.05).setting, 2u);
  EXPECT_EQ(cheapestWithin(r, 0.015).setting, 1u);
  r.settings[1].memory_bytes = kNotMeasured;
  EXPECT_EQ(cheapestWithin(r, 0.015).setting, 0u);
}

TEST(Answer, TheBestWithinTimeAndMemoryNeedsBoth) {
  const Report r = sample();
  EXPECT_EQ(bestWithin(r, 10, 100).setting, 2u);
  EXPECT_EQ(bestWithin(r, 9, 16).setting, 2u);
  EXPECT_EQ(bestWithin(r, 8.9, 100).setting, 0u);
  EXPECT_EQ(bestWithin(r, 8.9, 63).setting, 3u);
  EXPECT_EQ(bestWithin(r, 1, 32).setting, 1u);
  EXPECT_EQ(bestWithin(r, kAny, 100).setting, 4u);  // whose time is not known
  EXPECT_EQ(bestWithin(r, 2, kAny).setting, 0u);
  const Answer none = bestWithin(r, 1, 7);
  EXPECT_FALSE(none.setting);
  EXPECT_NE(none.line.find("within 1 ms and 7 MiB; nearest is beaten"), std::string::npos) << none.line;
}

TEST(Answer, OtherBakesAndBaselinesAreTakenAsAskedFor) {
  Report r = sample();
  r.settings[1].bakes_anew = true;
  r.settings[0].run.solver = "";
  EXPECT_EQ(cheapestWithin(r, 0.1).setting, 1u);
  EXPECT_EQ(cheapestWithin(r, 0.1, {.other_bakes = false}).setting, 3u);
  EXPECT_EQ(cheapestWithin(r, 0.1, {.other_bakes = false, .baselines = true}).setting, 0u);
  EXPECT_EQ(bestWithin(r, 2, kAny, {.other_bakes = false}).setting, std::nullopt);
}

class Recommended : public testing::Test {
 protected:
  std::string text() {
    std::ifstream in(folder_.file("town.settings.json"), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  }
  std::string world() const { return folder_.file("town.ffm"); }
  formats::TemporaryFolder folder_;
};

TEST_F(Recommended, ReadsBackAsTheRunTimeTakesIt) {
  Report r = sample();
  r.settings[2].run = {"multibounce", "fp16", true, 2048, 3, 10.5, static_cast<double>(1.6f), 3000};
  ASSERT_TRUE(writeRecommendation(world(), r, 2));
  auto read = runtime::readRecommendation(world());
  ASSERT_TRUE(read && read->has_value());
  EXPECT_EQ((**read).kind, runtime::SolverKind::kMultibounce);
  EXPECT_EQ((**read).storage, runtime::Storage::kFloat16);
  EXPECT_TRUE((**read).luminance);
  EXPECT_EQ((**read).places, 2048u);
  EXPECT_EQ((**read).iterations, 3);
  EXPECT_EQ((**read).radius_m, 10.5f);
  EXPECT_EQ((**read).growth, 1.6f);
  EXPECT_EQ((**read).max_patches, 3000u);
  EXPECT_NE(text().find("\"growth\": 1.6,"), std::string::npos) << text();
  EXPECT_NE(text().find("\"lamps\": 0.01"), std::string::npos) << text();
  const std::string once = text();
  ASSERT_TRUE(writeRecommendation(world(), r, 2));
  EXPECT_EQ(text(), once);
  ASSERT_TRUE(writeRecommendation(world(), r, 5));  // replaces it; what is not known is not in it
  read = runtime::readRecommendation(world());
  ASSERT_TRUE(read && read->has_value());
  EXPECT_EQ((**read).kind, runtime::SolverKind::kGather);
  EXPECT_FALSE((**read).radius_m || (**read).growth || (**read).max_patches);
  EXPECT_EQ(text().find("null"), std::string::npos) << text();
}

TEST_F(Recommended, IsRefusedWhereTheRunTimeCannotBeToldOrTheFolderIsNotThere) {
  Report r = sample();
  r.settings[0].run.solver = "";
  auto refused = writeRecommendation(world(), r, 0);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUsage);
  EXPECT_EQ(text(), "");
  refused = writeRecommendation(folder_.file("no/such/town.ffm"), r, 1);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
}

TEST(SettingCharts, GroupByWhatVariesAndJoinTheFront) {
  const Report r = sample();
  const Chart chart = speedAccuracyChart(r, "lamps");
  EXPECT_EQ(chart.id, "speed-accuracy-lamps");
  ASSERT_EQ(chart.series.size(), 3u);  // front, default, knob
  EXPECT_TRUE(chart.series[0].steps && !chart.series[0].dots);
  ASSERT_EQ(chart.series[0].points.size(), 3u);
  EXPECT_EQ(chart.series[0].points[2].x, 3);
  EXPECT_EQ(chart.series[0].points[2].y, 1);
  EXPECT_EQ(chart.series[1].name, "default");
  ASSERT_EQ(chart.series[1].points.size(), 1u);
  EXPECT_TRUE(chart.series[1].points[0].marked);
  EXPECT_EQ(chart.series[1].points[0].x_error, 0.01);
  EXPECT_EQ(chart.series[2].points.size(), 5u);
  EXPECT_FALSE(chart.series[2].lines);
  const std::string& hover = chart.series[1].points[0].hover;
  for (const char* part : {"default", "lamps: error 4.00", "relight 2.00", "memory 64 MiB", "rays 4096"})
    EXPECT_NE(hover.find(part), std::string::npos) << hover;
  EXPECT_EQ(hover.find("sun"), std::string::npos);
  EXPECT_EQ(hover.find("disk"), std::string::npos);  // not measured
}

TEST(SettingCharts, LeaveOutChartsWithoutAPoint) {
  Report r = sample();
  std::vector<std::string> ids;
  for (const Chart& chart : settingCharts(r)) ids.push_back(chart.id);
  EXPECT_EQ(ids, (std::vector<std::string>{"speed-accuracy-sun", "speed-accuracy-lamps", "error-memory-sun", "error-memory-lamps"}));
  r.settings[3].bake_seconds = 12;
  EXPECT_EQ(settingCharts(r).size(), 6u);
  EXPECT_TRUE(settingCharts({}).empty());
}

}  // namespace
}  // namespace ff::chart
