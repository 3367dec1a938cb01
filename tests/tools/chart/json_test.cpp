// The JSON document of ffchart: every figure, whatever its value; every text, whatever its bytes.
#include "tools/chart/page/json_report.h"

#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>

namespace ff::chart {
namespace {

using nlohmann::json;

Setting measured() {
  Setting s;
  s.name = "default";
  s.is_default = s.on_front = true;
  s.knobs = {{"rays", "4096"}, {"radius", "12 m"}};
  s.relight_ms = {1.0 / 3, 0.0625};
  s.disk_bytes = 123456789;
  s.accuracy = {{"sun", {0.1, kNotMeasured}}, {"lamps", {kNotMeasured, 0.5}}};
  s.run.solver = "gather";
  s.run.radius_m = static_cast<double>(1.6f);
  s.world = "worlds/a.ffm";
  return s;
}

Measured swaps() {
  return {.scene = "box",
          .method = "seed",
          .knob = "swaps",
          .unit = "",
          .points = {{100, 0.001}, {1000, std::numeric_limits<double>::infinity()}},
          .then = "built anew"};
}

TEST(JsonDocument, HasEveryFigureInFullAndNullWhereThereIsNone) {
  Report r;
  r.title = "A town";
  r.settings = {measured()};
  r.sources = {{"sun", 3, {{"cut", {0.01, 0.002}, "streamed against full"}}}};
  r.facts = {{"seed", "1"}};
  r.seen = {{.light = "sky", .full_solve = {.light = "sky", .energy = {0.4, 0.1}}, .own_median = 0.03, .not_drawn = 0.25, .eyes = 8, .pixels = 512, .patches = 495}};
  const json page = json::parse(jsonDocument("1.2", "ffchart a.glb", {{"accuracy", "out/accuracy.html", r}})).at("accuracy");
  EXPECT_EQ(page.at("page"), "out/accuracy.html");
  EXPECT_EQ(page.at("facts").at("seed"), "1");
  const json& s = page.at("settings").at(0);
  EXPECT_EQ(s.at("relight_ms").get<double>(), 1.0 / 3);
  EXPECT_EQ(s.at("relight_ms_error").get<double>(), 0.0625);
  EXPECT_EQ(s.at("disk_bytes").get<double>(), 123456789);
  EXPECT_TRUE(s.at("memory_bytes").is_null());
  EXPECT_TRUE(s.at("update_ms_per_tile_error").is_null()) << "no figure, no error of it";
  EXPECT_EQ(s.at("on_front"), true);
  EXPECT_EQ(s.at("bakes_anew"), false);
  EXPECT_EQ(s.at("knobs").at("radius"), "12 m");
  EXPECT_EQ(s.at("world"), "worlds/a.ffm");
  EXPECT_EQ(s.at("run").at("radius_m").get<double>(), 1.6) << "as the settings beside a world have it";
  EXPECT_EQ(s.at("accuracy").at(0).at("rel_l2").get<double>(), 0.1);
  EXPECT_TRUE(s.at("accuracy").at(0).at("rel_l2_error").is_null());
  EXPECT_TRUE(s.at("accuracy").at(1).at("rel_l2_error").is_null());
  const json& seen = page.at("seen").at(0);
  EXPECT_EQ(seen.at("light"), "sky");
  EXPECT_EQ(seen.at("pixels"), 512);
  EXPECT_EQ(seen.at("not_drawn").get<double>(), 0.25);
  EXPECT_EQ(seen.at("own_median").get<double>(), 0.03);
  EXPECT_EQ(seen.at("full_solve").at("energy").get<double>(), 0.4);
  EXPECT_TRUE(seen.at("streamed").at("energy").is_null());
  EXPECT_TRUE(seen.at("tracer_noise").is_null());
  const json& source = page.at("sources").at(0).at("sources").at(0);
  EXPECT_EQ(source.at("rel_l2").get<double>(), 0.01);
  EXPECT_EQ(source.at("rel_l2_error").get<double>(), 0.002);
}

TEST(JsonDocument, NamesTheAnswersSettingAndWhereItIsWritten) {
  Report r;
  r.settings = {measured()};
  Answered found, none;
  found.rel_l2 = 0.03;
  found.answer.setting = 0;
  found.written = "a.settings.json";
  none.answer.line = "nothing";
  const json answers = json::parse(jsonDocument("", "", {{"accuracy", "", r, {found, none}}})).at("accuracy").at("answers");
  EXPECT_EQ(answers.at(0).at("setting"), "default");
  EXPECT_EQ(answers.at(0).at("at_most_rel_l2").get<double>(), 0.03);
  EXPECT_FALSE(answers.at(0).contains("at_most_relight_ms"));
  EXPECT_EQ(answers.at(0).at("written"), "a.settings.json");
  EXPECT_TRUE(answers.at(1).at("setting").is_null());
  EXPECT_EQ(answers.at(1).at("line"), "nothing");
  EXPECT_TRUE(answers.at(1).at("written").is_null());
}

TEST(JsonDocument, HoldsTablesChartsAndCasesOfEveryPage) {
  Report stability, paper;
  stability.cases = {swaps()};
  stability.tables = {{"where-it-breaks", "Where", "", {"case", "past 1 %"}, {{"box: swaps", "1,000"}}}};
  paper.facts = {{"scene", "one"}, {"scene", "two"}};
  Chart chart;
  chart.id = "paper-relight-1";
  chart.series.push_back({"seed", {{256, 0.5, 0.1}, {1024, kNotMeasured}}});
  paper.charts = {chart};
  const json document =
      json::parse(jsonDocument("1", "ffchart", {{"stability", "s.html", stability}, {"paper", "p.html", paper}}));
  const json& points = document.at("stability").at("cases").at(0).at("points");
  EXPECT_EQ(points.at(0).at("at").get<double>(), 100);
  EXPECT_EQ(points.at(0).at("error").get<double>(), 0.001);
  EXPECT_TRUE(points.at(1).at("error").is_null());
  EXPECT_EQ(document.at("stability").at("tables").at(0).at("rows").at(0).at(1), "1,000");
  const json& series = document.at("paper").at("charts").at(0).at("series").at(0);
  EXPECT_EQ(series.at("points").at(0).at("y_error").get<double>(), 0.1);
  EXPECT_TRUE(series.at("points").at(1).at("y").is_null());
  EXPECT_EQ(document.at("paper").at("facts").at("scene"), "one; two");
  EXPECT_FALSE(document.contains("accuracy"));
}

TEST(JsonDocument, IsOneLineOfValidJsonWhateverTheTexts) {
  Report r;
  r.title = "\"quoted\" \\ \n \x01 \xff\xfe </script>";
  r.settings = {measured()};
  r.settings[0].name = r.settings[0].note = r.title;
  r.settings[0].knobs = {{r.title, r.title}};
  const std::string text = jsonDocument("1", r.title, {{"accuracy", "", r}});
  EXPECT_EQ(text.find('\n'), std::string::npos);
  const json document = json::parse(text, nullptr, false);
  ASSERT_FALSE(document.is_discarded()) << text;
  EXPECT_EQ(document.at("accuracy").at("title"), "\"quoted\" \\ \n \x01 \uFFFD\uFFFD </script>");
}

}  // namespace
}  // namespace ff::chart
