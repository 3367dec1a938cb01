#include "tools/chart/figure_text.h"
#include "tools/chart/page_html.h"

namespace ff::chart {
namespace {

constexpr const char* kHeader =
    "setting,varies,is_default,bakes_anew,on_front,relight_ms,relight_ms_error,update_ms_per_tile,"
    "update_ms_per_tile_error,disk_bytes,memory_bytes,bake_seconds,patches,active_nodes,light,rel_l2,rel_l2_error,median,"
    "median_error,p95,p95_error,p99,p99_error,energy,energy_error,full_solve_rel_l2,full_solve_rel_l2_error,knobs,note\n";

std::string quoted(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"') out += '"';
    out += c;
  }
  return out + "\"";
}

void put(std::string& line, const Figure& f) {
  const bool measured = !exactNumber(f.value).empty();
  line += exactNumber(f.value) + "," + (measured ? exactNumber(f.error) : "") + ",";
}

}  // namespace

std::string csvTable(const Report& report) {
  std::string csv = kHeader;
  for (const Setting& s : report.settings) {
    std::string front = quoted(s.name) + "," + quoted(s.varies) + ",";
    for (const bool flag : {s.is_default, s.bakes_anew, s.on_front}) front += flag ? "1," : "0,";
    put(front, s.relight_ms);
    put(front, s.update_ms_per_tile);
    for (const double v : {s.disk_bytes, s.memory_bytes, s.bake_seconds, s.patches, s.active_nodes})
      front += exactNumber(v) + ",";
    std::string knobs;
    for (const auto& [knob, value] : s.knobs) knobs += (knobs.empty() ? "" : "; ") + knob + " = " + value;
    const std::string back = quoted(knobs) + "," + quoted(s.note) + "\n";
    const std::vector<Accuracy> none(1);
    for (const Accuracy& a : s.accuracy.empty() ? none : s.accuracy) {
      csv += front + quoted(a.light) + ",";
      for (const Figure& f : {a.rel_l2, a.median, a.p95, a.p99, a.energy, a.full_solve_rel_l2}) put(csv, f);
      csv += back;
    }
  }
  return csv;
}

}  // namespace ff::chart
