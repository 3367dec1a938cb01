#include "tools/chart/page/page.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>

#include "tests/support/random_world.h"
#include "tools/chart/page/axis.h"
#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/page_html.h"

namespace ff::chart {
namespace {

constexpr const char* kHostile = "<script>alert(\"a\" & 'b')</script>\x01\xff]]>";

size_t count(const std::string& text, const std::string& part) {
  size_t n = 0;
  for (size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

// All tags are closed in the order that they were opened, all entities known, nothing that XML forbids. Not a parser:
// enough for documents without comments and CDATA.
std::string whatIsWrongWith(const std::string& xml) {
  std::vector<std::string> open;
  for (size_t i = 0; i < xml.size(); ++i) {
    if (static_cast<unsigned char>(xml[i]) < 0x20 && xml[i] != '\n') return "control character at " + std::to_string(i);
    if (xml[i] == '&') {
      const std::string entity = xml.substr(i, xml.find(';', i) + 1 - i);
      if (entity != "&amp;" && entity != "&lt;" && entity != "&gt;" && entity != "&quot;" && entity != "&#39;")
        return "entity " + entity.substr(0, 20);
    }
    if (xml[i] == '>') return "a lone > at " + std::to_string(i);
    if (xml[i] != '<') continue;
    size_t end = i + 1;
    for (bool quoted = false; end < xml.size() && (quoted || xml[end] != '>'); ++end)
      if (xml[end] == '"') quoted = !quoted;
    if (end == xml.size()) return "a tag that does not end";
    const std::string tag = xml.substr(i + 1, end - i - 1);
    if (tag.find('<') != std::string::npos) return "< in a tag";
    if (tag[0] == '/') {
      if (open.empty() || open.back() != tag.substr(1)) return "</" + tag.substr(1) + "> closes nothing";
      open.pop_back();
    } else if (tag.back() != '/') {
      open.push_back(tag.substr(0, tag.find(' ')));
    }
    i = end;
  }
  return open.empty() ? "" : "<" + open.back() + "> is not closed";
}

std::vector<std::pair<double, double>> pointsOf(const std::string& svg) {
  std::vector<std::pair<double, double>> points;
  const std::regex place("class=\"point\" transform=\"translate\\(([-0-9.]+) ([-0-9.]+)\\)");
  for (std::sregex_iterator i(svg.begin(), svg.end(), place), end; i != end; ++i)
    points.push_back({std::stod((*i)[1]), std::stod((*i)[2])});
  return points;
}

Chart lineOf(std::vector<Series::Point> points) {
  Chart chart;
  chart.id = "a";
  chart.title = "Title";
  chart.x_label = "x, ms";
  chart.y_label = "y, %";
  chart.series.push_back({"one", std::move(points)});
  return chart;
}

TEST(SvgChart, PutsPointsInProportionOnLinearAndLogarithmicAxes) {
  Chart chart = lineOf({{0, 0}, {1, 5}, {4, 10}});
  auto at = pointsOf(svgChart(chart));
  ASSERT_EQ(at.size(), 3u);
  EXPECT_NEAR((at[1].first - at[0].first) / (at[2].first - at[0].first), 0.25, 0.001);
  EXPECT_NEAR((at[1].second - at[0].second) / (at[2].second - at[0].second), 0.5, 0.001);
  EXPECT_LT(at[2].second, at[0].second);  // up is more
  chart = lineOf({{0.1, 1}, {1, 10}, {1000, 100}});
  chart.log_x = chart.log_y = true;
  at = pointsOf(svgChart(chart));
  ASSERT_EQ(at.size(), 3u);
  EXPECT_NEAR((at[1].first - at[0].first) / (at[2].first - at[0].first), 0.25, 0.001);
  EXPECT_NEAR((at[1].second - at[0].second) / (at[2].second - at[0].second), 0.5, 0.001);
}

TEST(SvgChart, LeavesOutWhatCannotBeShownAndSaysSo) {
  Chart chart = lineOf({{1, 1}, {2, kNotMeasured}, {0, 3}, {-1, 3}, {4, 0}, {5, HUGE_VAL}, {6, 2}});
  EXPECT_EQ(pointsOf(svgChart(chart)).size(), 5u);
  EXPECT_NE(svgChart(chart).find("2 points are not shown"), std::string::npos);
  chart.log_x = chart.log_y = true;
  const std::string svg = svgChart(chart);
  EXPECT_EQ(pointsOf(svg).size(), 2u);
  EXPECT_NE(svg.find("5 points are not shown: not measured, or not above zero"), std::string::npos);
  EXPECT_EQ(svg.find("nan"), std::string::npos);
  EXPECT_EQ(svg.find("inf"), std::string::npos);
  EXPECT_EQ(svgChart(lineOf({{1, 1}, {2, 2}})).find("not shown"), std::string::npos);
}

TEST(SvgChart, BreaksALineWhereAPointIsMissing) {
  const std::string svg = svgChart(lineOf({{0, 1}, {1, 2}, {2, kNotMeasured}, {3, 2}, {4, 3}}));
  const std::regex line("<path class=\"line\" d=\"M[^M]*L[^M]*M[^M]*L[^M]*\"");
  EXPECT_TRUE(std::regex_search(svg, line)) << svg;
}

TEST(SvgChart, DrawsAxesOfSomeWidthForOnePointAndForNone) {
  for (const bool log : {false, true})
    for (const double v : {0.0, -3.0, 1e-9, 7.0, 1e140}) {
      Chart chart = lineOf({{v, v, 0, "", true}});
      chart.log_x = chart.log_y = log;
      const std::string svg = svgChart(chart);
      EXPECT_EQ(whatIsWrongWith(svg), "") << v;
      EXPECT_EQ(svg.find("nan"), std::string::npos) << v;
      EXPECT_GE(count(svg, "class=\"grid\""), 4u) << v << (log ? " log" : "");
      for (const auto& [x, y] : pointsOf(svg)) {
        EXPECT_GT(x, 60) << v;
        EXPECT_LT(x, 620) << v;
      }
    }
  Chart empty;
  EXPECT_EQ(whatIsWrongWith(svgChart(empty)), "");
  EXPECT_NE(svgChart(empty).find("nothing was measured"), std::string::npos);
  empty.series.resize(3);
  EXPECT_EQ(whatIsWrongWith(svgChart(empty)), "");
}

TEST(SvgChart, EscapesEveryTextThatIsPutIntoIt) {
  Chart chart = lineOf({{1, 2, 0.5, kHostile, true}, {2, 3, 0, "", false}, {3, 4, 0, "a > b", false}});
  chart.title = chart.x_label = chart.y_label = chart.note = chart.series[0].name = kHostile;
  chart.series[0].points[1].label = kHostile;
  chart.series.push_back(chart.series[0]);
  chart.series[1].lines = false;  // so that there is a legend
  chart.y_marks = {{2.5, kHostile}};
  chart.x_marks = {{2.5, kHostile}};
  const std::string svg = svgChart(chart);
  EXPECT_EQ(whatIsWrongWith(svg), "");
  EXPECT_EQ(count(svg, "<script"), 0u);
  EXPECT_GE(count(svg, "&lt;script&gt;"), 8u);
}

TEST(SvgChart, SaysTheWholeSettingWhereThePointerRests) {
  Chart chart = lineOf({{1, 2, 0, "radius 12 m, 0.84 ms", false}, {0.5, 2.4142135, 0.03, "", false}});
  const std::string svg = svgChart(chart);
  EXPECT_NE(svg.find("<title>radius 12 m, 0.84 ms</title>"), std::string::npos);
  EXPECT_NE(svg.find("<title>one: x, ms 0.500, y, % 2.41 \u00b1 0.03</title>"), std::string::npos) << svg;
}

TEST(SvgChart, DrawsAFrontAsStairsWithoutDots) {
  Chart chart = lineOf({{1, 4}, {2, 3}, {3, 1}});
  chart.series[0].steps = true;
  chart.series[0].dots = false;
  const std::string svg = svgChart(chart);
  EXPECT_TRUE(std::regex_search(svg, std::regex("class=\"reference\" d=\"M[-0-9. ]+H[-0-9.]+V[-0-9.]+H[-0-9.]+V[-0-9.]+\"")));
  EXPECT_TRUE(pointsOf(svg).empty());
}

TEST(SvgChart, DrawsErrorBarsThatCanBeSeenAndRingsWhatIsMarked) {
  const std::string svg = svgChart(lineOf({{0, 1, 0.5, "", true}, {1, 2, 1e-6, "", false}, {2, 3, kNotMeasured, "", false}}));
  const std::regex bar("class=\"bar\" d=\"([^\"]*)\"");
  std::smatch found;
  ASSERT_TRUE(std::regex_search(svg, found, bar));
  EXPECT_EQ(count(found[1], "V"), 1u);
  EXPECT_EQ(count(svg, "class=\"ring\""), 1u);
}

TEST(SvgChart, KeepsTheBarOfAnErrorAsLargeAsItsFigureInsideTheChart) {
  Chart chart = lineOf({{1, 2, 2.5, "", false}, {10, 20, 1, "", false}});
  chart.log_x = chart.log_y = true;
  const std::string svg = svgChart(chart);
  EXPECT_EQ(svg.find("nan"), std::string::npos);
  std::smatch box;
  ASSERT_TRUE(std::regex_search(svg, box, std::regex("viewBox=\"0 0 ([0-9.]+) ([0-9.]+)\"")));
  const std::regex down("V([-0-9.]+)");
  for (std::sregex_iterator i(svg.begin(), svg.end(), down), end; i != end; ++i) EXPECT_LT(std::stod((*i)[1]), std::stod(box[2]));
}

TEST(SvgChart, NamesFewLinesAtTheirEndsAndOthersInALegend) {
  Chart chart;
  for (int i = 0; i < 2; ++i) chart.series.push_back({"line " + std::to_string(i), {{0, 1.0 + i}, {1, 2}}});
  EXPECT_EQ(count(svgChart(chart), "class=\"lead\""), 2u);
  for (const char* name : {">line 0</text>", ">line 1</text>"}) EXPECT_EQ(count(svgChart(chart), name), 1u);
  for (int i = 2; i < 9; ++i) chart.series.push_back({"line " + std::to_string(i), {{0, 1.0 + i}, {1, 2}}});
  const std::string legend = svgChart(chart);
  EXPECT_EQ(count(legend, "class=\"lead\""), 0u);
  for (int i = 0; i < 9; ++i) EXPECT_EQ(count(legend, ">line " + std::to_string(i) + "</text>"), 1u);
}

TEST(SvgChart, KeepsTheLookOfASeriesWhereAnotherHasNoPoints) {
  Chart chart;
  for (const char* name : {"a", "b", "c"}) chart.series.push_back({name, {{0, 1}, {1, 2}}, false});
  const auto lookOfC = [&] {
    std::smatch found;
    const std::string svg = svgChart(chart);
    const std::regex swatch("class=\"(c[0-9])\"[^>]*>(<path class=\"shape\"[^>]*>)</g><text[^>]*>c<");
    return std::regex_search(svg, found, swatch) ? found.str(1) + found.str(2) : std::string();
  };
  const std::string look = lookOfC();
  EXPECT_EQ(look.substr(0, 2), "c2");
  chart.series[1].points.clear();
  EXPECT_EQ(lookOfC(), look);
}

TEST(SvgChart, IsTheSameForTheSameChart) {
  const Chart chart = lineOf({{1, 2, 0.5, "", true}, {2, 3, 0.1, "", false}});
  EXPECT_EQ(svgChart(chart), svgChart(chart));
}

TEST(Axis, StepsBy125AndHoldsAllValues) {
  for (const auto& [lo, hi] : {std::pair{0.0, 9.7}, {-3.2, 1.1}, {0.001, 0.00104}, {1e5, 1e5 + 3}, {-2e9, 8e9}}) {
    const std::vector<double> values{lo, hi};
    const Axis axis(values, false);
    EXPECT_LE(axis.lo(), lo);
    EXPECT_GE(axis.hi(), hi);
    const auto& ticks = axis.ticks();
    ASSERT_GE(ticks.size(), 3u);
    EXPECT_LE(ticks.size(), 9u);
    const double step = ticks[1].at - ticks[0].at, first = step / std::pow(10, std::floor(std::log10(step) + 1e-6));
    EXPECT_TRUE(std::abs(first - 1) < 1e-3 || std::abs(first - 2) < 1e-3 || std::abs(first - 5) < 1e-3) << first;
    for (size_t i = 1; i < ticks.size(); ++i) EXPECT_NE(ticks[i].label, ticks[i - 1].label);
  }
}

TEST(Axis, OfManyDecadesNumbersDecadesAlone) {
  const std::vector<double> wide{1e-12, 1e3}, narrow{0.2, 30};
  const Axis decades(wide, true), fine(narrow, true);
  size_t labelled = 0;
  for (const Axis::Tick& tick : decades.ticks()) {
    EXPECT_NEAR(std::log10(tick.at), std::round(std::log10(tick.at)), 1e-6);
    labelled += tick.label.empty() ? 0 : 1;
  }
  EXPECT_GE(labelled, 5u);
  EXPECT_LE(labelled, 10u);
  std::vector<std::string> labels;
  for (const Axis::Tick& tick : fine.ticks()) labels.push_back(tick.label);
  EXPECT_EQ(labels, (std::vector<std::string>{"0.2", "0.5", "1", "2", "5", "10", "20"}));
}

TEST(FigureText, ShowsSensibleDigits) {
  const std::pair<double, const char*> numbers[] = {{0, "0"},          {59890, "59,890"},    {0.012345678, "0.0123"},
                                                    {4.2, "4.20"},     {99.96, "100"},       {-1234567.8, "-1,234,568"},
                                                    {12, "12"},        {1e-6, "10\u207b\u2076"},
                                                    {0.1 + 0.2, "0.300"}, {kNotMeasured, "\u2014"}};
  for (const auto& [value, text] : numbers) EXPECT_EQ(shortNumber(value), text) << value;
  EXPECT_EQ(withError({0.02414, 0.00031}, 100), "2.41 \u00b1 0.03");
  EXPECT_EQ(withError({100.0312, 0.0312}), "100.03 \u00b1 0.03");
  EXPECT_EQ(withError({2.41, 0}), "2.41");
  EXPECT_EQ(withError({2.41, kNotMeasured}), "2.41");
  EXPECT_EQ(withError({kNotMeasured, 1}), "\u2014");
  EXPECT_EQ(withError({12345, 250}), "12,345 \u00b1 250");
  EXPECT_EQ(withError({0, 0.1}), "0.0 \u00b1 0.1");
  EXPECT_EQ(exactNumber(0.1), "0.1");
  EXPECT_EQ(exactNumber(kNotMeasured), "");
}

TEST(FigureText, KeepsGoodUtf8AndReplacesTheRest) {
  EXPECT_EQ(escaped("5 \u00d7 10\u207b\u00b3 \u20ac \U0001F600"), "5 \u00d7 10\u207b\u00b3 \u20ac \U0001F600");
  const std::string bad = "\xEF\xBF\xBD";
  EXPECT_EQ(escaped("a\xc3"), "a" + bad);                            // cut short
  EXPECT_EQ(escaped("\xc0\xaf"), bad + bad);                         // longer than need be
  EXPECT_EQ(escaped("\xed\xa0\x80"), bad + bad + bad);               // a surrogate
  EXPECT_EQ(fileWord("Sun & sky / 1 m"), "sun-sky-1-m");
  EXPECT_EQ(fileWord("../../"), "chart");
}

Report everySection() {
  Report r;
  r.title = "Town";
  r.lead = "Gather is enough.";
  r.facts = {{"world", "town.ffm"}, {"command", "ffchart \"a b\".ffm"}};
  Setting a;
  a.name = "default, \"as is\"";
  a.is_default = a.on_front = true;
  a.knobs = {{"rays", "4096"}, {"radius", "12 m"}};
  a.relight_ms = {0.84210526315789, 0.03};
  a.memory_bytes = 3 * 1048576;
  a.accuracy = {{"sun, sky", {1.0 / 3, 0.01}, {0.01, 0}, {}, {}, {}, {}}, {"lamps", {0.05, 0.002}, {}, {}, {}, {}, {}}};
  Setting b;
  b.name = kHostile;
  b.varies = "rays";
  b.note = "two\nlines";
  r.settings = {a, b};
  r.charts = {lineOf({{1, 2}, {2, 3}})};
  r.tables = {{"t", "A table", "note", {"method", "ms"}, {{"ours", "1.5"}, {"theirs"}}}};
  return r;
}

TEST(CsvTable, HasALineASettingAndLightWithFullPrecision) {
  const std::string csv = csvTable(everySection());
  std::vector<std::string> lines;
  std::istringstream in(csv.substr(0, csv.find("\"<script")));
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  ASSERT_EQ(lines.size(), 3u);
  EXPECT_EQ(lines[0].rfind("setting,varies,is_default,bakes_anew,on_front,relight_ms,", 0), 0u);
  EXPECT_EQ(lines[1],
            "\"default, \"\"as is\"\"\",,1,0,1,0.84210526315789,0.03,,,,3145728,,,,\"sun, sky\",0.3333333333333333,0.01,0.01,0,"
            ",,,,,,,,rays = 4096; radius = 12 m,");
  EXPECT_EQ(lines[2].find(",lamps,0.05,0.002,,"), lines[2].find(",lamps,"));
  EXPECT_NE(csv.find("\"two\nlines\"\n"), std::string::npos);
  Report none;
  EXPECT_EQ(csvTable(none), lines[0] + "\n");
}

TEST(HtmlPage, ShowsWhatWasMeasuredAndADashForWhatWasNot) {
  const std::string html = htmlPage(everySection(), {});
  EXPECT_NE(html.find("0.842 \u00b1 0.030"), std::string::npos);
  EXPECT_EQ(html.find(">0.84210526315789"), std::string::npos);
  EXPECT_NE(html.find("33.3 \u00b1 1.0"), std::string::npos);
  EXPECT_NE(html.find("<td>\u2014</td>"), std::string::npos);
  EXPECT_NE(html.find("relight, ms"), std::string::npos);
  EXPECT_EQ(html.find("bake, s"), std::string::npos);  // no setting has it
  EXPECT_NE(html.find("<tr class=\"default front\">"), std::string::npos);
  EXPECT_NE(html.find("Made by <code>ffchart &quot;a b&quot;.ffm</code>"), std::string::npos);
  EXPECT_LT(html.find("Gather is enough."), html.find("<svg"));
  EXPECT_EQ(count(html, "<script"), 1u);
  for (const char* elsewhere : {"src=\"http", "href=\"http", "@import", "url("}) EXPECT_EQ(count(html, elsewhere), 0u);
  EXPECT_EQ(count(htmlPage({}, {}), "<table"), 0u);
}

class Page : public testing::Test {
 protected:
  std::string read(const std::string& name) {
    std::ifstream in(folder_.file(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  }
  void write(const std::string& name, const std::string& bytes) {
    std::ofstream(folder_.file(name), std::ios::binary) << bytes;
  }
  formats::TemporaryFolder folder_;
};

TEST_F(Page, WritesPageTableAndChartsAndTheSameBytesAgain) {
  write("map.png", std::string("\x89PNG\r\n\x1a\n") + "abc");
  Report report = everySection();
  report.pictures = {{"map.png", "Worst places", "in red"}};
  report.charts.push_back(report.charts[0]);  // of the same id
  const auto written = writePage(report, folder_.path(), "town");
  ASSERT_TRUE(written) << written.error().line();
  for (const std::string& file : written->files) EXPECT_TRUE(std::filesystem::file_size(file) > 0) << file;
  for (const char* file : {"town.html", "town.csv", "a.svg", "a-2.svg"})
    EXPECT_EQ(std::count(written->files.begin(), written->files.end(), folder_.file(file)), 1) << file;
  EXPECT_EQ(read("a.svg"), svgChart(report.charts[0]));
  const std::string html = read("town.html");
  EXPECT_NE(html.find("src=\"data:image/png;base64,iVBORw0KGgphYmM=\""), std::string::npos);
  if (written->left_out.empty()) {
    EXPECT_EQ(read("a.png").compare(0, 8, "\x89PNG\r\n\x1a\n"), 0);
  }
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path()))
    EXPECT_NE(entry.path().extension(), ".part");
  const std::string csv = read("town.csv"), png = read("a.png");
  ASSERT_TRUE(writePage(report, folder_.path(), "town"));
  EXPECT_EQ(read("town.html"), html);
  EXPECT_EQ(read("town.csv"), csv);
  EXPECT_EQ(read("a.png"), png);
}

TEST_F(Page, DoesWithoutPngsWhereNothingCanDrawThem) {
  const std::string path = std::getenv("PATH");
  ::setenv("PATH", folder_.path().c_str(), 1);
  const auto written = writePage(everySection(), folder_.path() + "/new/folder", "town");
  ::setenv("PATH", path.c_str(), 1);
  ASSERT_TRUE(written) << written.error().line();
  EXPECT_NE(written->left_out.find("librsvg2-bin"), std::string::npos);
  EXPECT_EQ(written->files.size(), 3u);  // SVG, CSV, page
  EXPECT_FALSE(std::filesystem::exists(folder_.file("new/folder/a.png")));
}

TEST_F(Page, NamesTheFileThatCannotBeReadOrWritten) {
  Report report = everySection();
  report.pictures = {{"nowhere.png", "", ""}};
  auto refused = writePage(report, folder_.path(), "town");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
  EXPECT_NE(refused.error().line().find("nowhere.png"), std::string::npos);
  write("nowhere.png", "GIF89a");
  refused = writePage(report, folder_.path(), "town");
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().line().find("is no PNG"), std::string::npos);
  refused = writePage(everySection(), folder_.file("nowhere.png"), "town");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
}

}  // namespace
}  // namespace ff::chart
