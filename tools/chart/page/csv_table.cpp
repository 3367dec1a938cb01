#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/page_html.h"
#include "tools/chart/page/setting_figures.h"

namespace ff::chart {
namespace {

std::string quoted(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"') out += '"';
    out += c;
  }
  return out + "\"";
}

// Each cell and the comma after it. A figure has two: its value and its error.
struct Names {
  std::string line{};
  template <class Value>
  void operator()(const char* name, const Value&) {
    line += std::string(name) + ",";
  }
  void operator()(const char* name, const Figure&) { line += std::string(name) + "," + name + "_error,"; }
};

struct Cells {
  std::string line{};
  void operator()(const char*, const std::string& text) { line += quoted(text) + ","; }
  void operator()(const char*, bool flag) { line += flag ? "1," : "0,"; }
  void operator()(const char*, double value) { line += exactNumber(value) + ","; }
  void operator()(const char*, const Figure& f) {
    const std::string value = exactNumber(f.value);
    line += value + "," + (value.empty() ? "" : exactNumber(f.error)) + ",";
  }
};

}  // namespace

std::string csvTable(const Report& report) {
  Names names;
  eachFigure(Setting{}, names);
  eachFigure(Accuracy{}, names);
  std::string csv = names.line + "knobs,note\n";
  for (const Setting& s : report.settings) {
    Cells front;
    eachFigure(s, front);
    std::string knobs;
    for (const auto& [knob, value] : s.knobs) knobs += (knobs.empty() ? "" : "; ") + knob + " = " + value;
    const std::string back = quoted(knobs) + "," + quoted(s.note) + "\n";
    const std::vector<Accuracy> none(1);
    for (const Accuracy& a : s.accuracy.empty() ? none : s.accuracy) {
      Cells line = front;
      eachFigure(a, line);
      csv += line.line + back;
    }
  }
  return csv;
}

}  // namespace ff::chart
