#include "tools/chart/page/page_html.h"

#include <algorithm>
#include <cmath>

#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/front.h"
#include "tools/chart/page/page.h"

namespace ff::chart {
namespace {

constexpr double kMiB = 1048576;

constexpr const char* kStyle = R"(
:root{color-scheme:light dark;--ink:#1f2328;--quiet:#5f666d;--paper:#fff;--band:#f6f7f8;--rule:#dfe2e5;--accent:#0072b2}
@media (prefers-color-scheme:dark){:root{--ink:#e3e6e8;--quiet:#a0a6ac;--paper:#17191c;--band:#202327;--rule:#363b41;--accent:#4aa3df}}
*{box-sizing:border-box}
body{margin:0 auto;padding:2.5rem 1.25rem 4rem;max-width:76rem;background:var(--paper);color:var(--ink);
font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,"Liberation Sans",sans-serif}
h1{font-size:1.9rem;line-height:1.2;margin:0 0 1rem}h2{font-size:1.3rem;margin:3rem 0 .6rem}
.lead{font-size:1.12rem;max-width:50rem;margin:0 0 1.6rem;padding-left:1rem;border-left:4px solid var(--accent)}
p,figcaption,.note{max-width:50rem}figcaption,.note,footer{color:var(--quiet);font-size:.86rem;line-height:1.5}
.facts th{text-align:left;font-weight:400;color:var(--quiet);padding-right:1.5rem;white-space:nowrap}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(30rem,100%),1fr));gap:2rem 1.5rem}
figure{margin:0;min-width:0}figure svg,figure img{display:block;width:100%;height:auto}
.charts figure{border:1px solid var(--rule);border-radius:8px;padding:.4rem .4rem .9rem;overflow:hidden}.charts figcaption{padding:0 .8rem}
.wide{overflow-x:auto;margin:0 min(0px,(100% - 100vw)/2 + 1.75rem) .6rem 0}
table{border-collapse:collapse;font-size:.86rem;line-height:1.35}
td,th{padding:.34rem .7rem;vertical-align:top}
.data thead th{border-bottom:2px solid var(--rule);font-weight:600;text-align:right;vertical-align:bottom}
.data thead tr:first-child th[colspan]{text-align:left;border-bottom:1px solid var(--rule)}
.data thead tr:first-child:not(:last-child) th:not([colspan]){border:0}
.data td{border-bottom:1px solid var(--rule);text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
.data td.word,.data thead th.word{text-align:left}
.data td.said{white-space:normal;min-width:14rem;text-align:left}
.data tbody tr:hover td{background:var(--band)}
.data td:first-child,.data thead th:first-child{padding-left:.2rem;position:sticky;left:0;background:var(--paper)}
.front td:first-child{font-weight:600}.front td:first-child::after{content:" \25CF";color:var(--accent)}
.data tr.default td{background:var(--band)}
th.sorts{cursor:pointer}th.sorts:hover{color:var(--accent)}
#tip{position:fixed;display:none;pointer-events:none;white-space:pre-line;max-width:28rem;padding:.5rem .7rem;border-radius:6px;
font-size:.8rem;line-height:1.45;background:var(--ink);color:var(--paper);box-shadow:0 2px 8px #0004;z-index:2}
th.up::after{content:" \2191"}th.down::after{content:" \2193"}
footer{margin-top:3.5rem;padding-top:1rem;border-top:1px solid var(--rule)}
code{font:.86rem/1.5 ui-monospace,"SFMono-Regular",Menlo,Consolas,"Liberation Mono",monospace;overflow-wrap:anywhere}
)";

// Columns sort by what their cells hold in data-v; those without go last, whichever way. What a point says comes up at
// once, where the browser alone would show its title after a while.
constexpr const char* kScripts = R"(
document.querySelectorAll("table.data").forEach(function(t){
 t.querySelectorAll("th[data-c]").forEach(function(h){
  h.classList.add("sorts");
  h.addEventListener("click",function(){
   var down=h.classList.contains("up"),c=+h.dataset.c,b=t.tBodies[0];
   t.querySelectorAll("th").forEach(function(o){o.classList.remove("up","down")});
   h.classList.add(down?"down":"up");
   Array.from(b.rows).map(function(r){return{r:r,v:r.cells[c].dataset.v}}).sort(function(x,y){
    var p=x.v===undefined||x.v==="",q=y.v===undefined||y.v==="";
    if(p||q)return p-q;
    var n=isNaN(x.v)||isNaN(y.v)?x.v.localeCompare(y.v):x.v-y.v;
    return down?-n:n}).forEach(function(o){b.appendChild(o.r)})})})});
var tip=document.body.appendChild(document.createElement("div"));tip.id="tip";
document.addEventListener("pointerover",function(e){
 var p=e.target.closest?e.target.closest(".point"):null;
 if(!p){tip.style.display="none";return}
 var t=p.querySelector("title");
 if(t){p.setAttribute("aria-label",t.textContent);t.remove()}
 tip.textContent=p.getAttribute("aria-label");tip.style.display="block";
 var r=p.getBoundingClientRect(),w=tip.offsetWidth,h=tip.offsetHeight;
 tip.style.left=Math.max(4,Math.min(r.right+8,innerWidth-w-12))+"px";
 tip.style.top=(r.top-h-8>4?r.top-h-8:r.bottom+8)+"px"});
addEventListener("scroll",function(){tip.style.display="none"},{passive:true});
)";

std::string paragraph(const std::string& text, const char* classes) {
  if (text.empty()) return "";
  std::string words = escaped(text);  // with each per cent sign on the line of its number
  for (size_t at = 0; (at = words.find(" %", at)) != std::string::npos;) words.replace(at, 1, "\u00a0");
  return std::string("<p class=\"") + classes + "\">" + words + "</p>\n";
}

std::string cell(const std::string& shown, const std::string& sorts_by, const char* classes = "") {
  std::string s = "<td";
  if (*classes) s += std::string(" class=\"") + classes + "\"";
  if (!sorts_by.empty()) s += " data-v=\"" + escaped(sorts_by) + "\"";
  return s + ">" + escaped(shown) + "</td>";
}

std::string cell(const Figure& f, double scale = 1) { return cell(withError(f, scale), exactNumber(f.value)); }
std::string cell(double value, double scale = 1) { return cell(shortNumber(value * scale), exactNumber(value)); }

bool measured(double value) { return std::isfinite(value); }

// A column of the table of settings that is left out where no setting has it.
struct Column {
  const char* name;
  bool (*known)(const Setting&);
  std::string (*cell_of)(const Setting&);
};

// What is asked first stands before the errors, the rest behind them.
const std::vector<Column> kFirstCosts = {
    {"relight, ms", [](const Setting& s) { return measured(s.relight_ms.value); },
     [](const Setting& s) { return cell(s.relight_ms); }},
    {"memory, MiB", [](const Setting& s) { return measured(s.memory_bytes); },
     [](const Setting& s) { return cell(s.memory_bytes, 1 / kMiB); }},
};
const std::vector<Column> kOtherCosts = {
    {"update, ms a tile", [](const Setting& s) { return measured(s.update_ms_per_tile.value); },
     [](const Setting& s) { return cell(s.update_ms_per_tile); }},
    {"disk, MiB", [](const Setting& s) { return measured(s.disk_bytes); },
     [](const Setting& s) { return cell(s.disk_bytes, 1 / kMiB); }},
    {"bake, s", [](const Setting& s) { return measured(s.bake_seconds); },
     [](const Setting& s) { return cell(s.bake_seconds); }},
    {"patches", [](const Setting& s) { return measured(s.patches); }, [](const Setting& s) { return cell(s.patches); }},
    {"active nodes", [](const Setting& s) { return measured(s.active_nodes); },
     [](const Setting& s) { return cell(s.active_nodes); }},
};

std::vector<Column> known(const std::vector<Column>& columns, const std::vector<Setting>& settings) {
  std::vector<Column> some;
  for (const Column& c : columns)
    if (std::any_of(settings.begin(), settings.end(), c.known)) some.push_back(c);
  return some;
}

struct AccuracyColumn {
  const char* name;
  Figure Accuracy::*figure;
};
constexpr AccuracyColumn kErrors[] = {{"rel. L2, %", &Accuracy::rel_l2}, {"median, %", &Accuracy::median},
                                      {"95th, %", &Accuracy::p95},       {"99th, %", &Accuracy::p99},
                                      {"energy, %", &Accuracy::energy},  {"run time alone, %", &Accuracy::full_solve_rel_l2}};

// The lights, in the order that they come up, each with the columns that some setting has.
struct LightColumns {
  std::string light;
  std::vector<AccuracyColumn> errors;
};
std::vector<LightColumns> lightColumns(const std::vector<Setting>& settings) {
  std::vector<LightColumns> lights;
  for (const Setting& s : settings)
    for (const Accuracy& a : s.accuracy)
      if (std::none_of(lights.begin(), lights.end(), [&](const LightColumns& l) { return l.light == a.light; }))
        lights.push_back({a.light, {}});
  for (LightColumns& l : lights)
    for (const AccuracyColumn& e : kErrors)
      if (std::any_of(settings.begin(), settings.end(), [&](const Setting& s) {
            const Accuracy* a = accuracyIn(s, l.light);
            return a && measured((a->*e.figure).value);
          }))
        l.errors.push_back(e);
  std::erase_if(lights, [](const LightColumns& l) { return l.errors.empty(); });
  return lights;
}

std::string settingsTable(const std::vector<Setting>& settings) {
  if (settings.empty()) return "";
  const std::vector<Column> first = known(kFirstCosts, settings), others = known(kOtherCosts, settings);
  const std::vector<LightColumns> lights = lightColumns(settings);
  const bool notes = std::any_of(settings.begin(), settings.end(), [](const Setting& s) { return !s.note.empty(); });

  size_t column = 0;
  const auto head = [&](const std::string& name, const char* classes = "") {
    return std::string("<th") + (*classes ? std::string(" class=\"") + classes + "\"" : "") + " data-c=\"" +
           std::to_string(column++) + "\">" + escaped(name) + "</th>";
  };
  std::string out = "<h2 id=\"settings\">All settings</h2>\n<div class=\"wide\"><table class=\"data\"><thead>\n";
  if (!lights.empty()) {
    out += "<tr><th></th><th></th>";
    for (size_t i = 0; i < first.size(); ++i) out += "<th></th>";
    for (const LightColumns& l : lights)
      out += "<th colspan=\"" + std::to_string(l.errors.size()) + "\">error, " + escaped(l.light) + "</th>";
    for (size_t i = 0; i < others.size() + (notes ? 1 : 0); ++i) out += "<th></th>";
    out += "</tr>\n";
  }
  out += "<tr>" + head("setting", "word") + head("varies", "word");
  for (const Column& c : first) out += head(c.name);
  for (const LightColumns& l : lights)
    for (const AccuracyColumn& e : l.errors) out += head(e.name);
  for (const Column& c : others) out += head(c.name);
  if (notes) out += head("note", "word");
  out += "</tr></thead>\n<tbody>\n";
  for (const Setting& s : settings) {
    std::string classes = s.is_default ? "default" : "";
    if (s.on_front) classes += classes.empty() ? "front" : " front";
    out += classes.empty() ? "<tr>" : "<tr class=\"" + classes + "\">";
    out += cell(s.name, s.name, "word") + cell(s.varies, s.varies, "word");
    for (const Column& c : first) out += c.cell_of(s);
    for (const LightColumns& l : lights) {
      const Accuracy* a = accuracyIn(s, l.light);
      for (const AccuracyColumn& e : l.errors) out += a ? cell(a->*e.figure, 100) : cell(kNotMeasuredText, "");
    }
    for (const Column& c : others) out += c.cell_of(s);
    if (notes) out += cell(s.note, s.note, "said");
    out += "</tr>\n";
  }
  out += "</tbody></table></div>\n";
  std::string note;
  if (std::any_of(settings.begin(), settings.end(), [](const Setting& s) { return s.on_front; }))
    note += "A dot: on the front; no other setting is both faster and more accurate. ";
  if (std::any_of(settings.begin(), settings.end(), [](const Setting& s) { return s.is_default; }))
    note += "Shaded: the default. ";
  return out + paragraph(note + "\u00b1 is one standard error, of times the spread. A click on a heading sorts.", "note");
}

// Right-aligned where it begins like a number.
bool looksLikeANumber(const std::string& s) {
  const size_t at = s.find_first_not_of("+-~<> ");
  return s == kNotMeasuredText || (at != std::string::npos && s[at] >= '0' && s[at] <= '9') || s.rfind("\u2212", 0) == 0;
}

std::string tableSection(const Table& t) {
  std::string out = "<h2 id=\"" + fileWord(t.id.empty() ? t.title : t.id) + "\">" + escaped(t.title) +
                    "</h2>\n<div class=\"wide\"><table class=\"data\"><thead><tr>";
  std::vector<bool> words(t.columns.size(), false);
  for (size_t c = 0; c < t.columns.size(); ++c) {
    for (const auto& row : t.rows)
      if (c < row.size() && !row[c].empty() && !looksLikeANumber(row[c])) words[c] = true;
    out += (words[c] ? "<th class=\"word\">" : "<th>") + escaped(t.columns[c]) + "</th>";
  }
  out += "</tr></thead>\n<tbody>\n";
  for (const auto& row : t.rows) {
    out += "<tr>";
    for (size_t c = 0; c < std::max(row.size(), t.columns.size()); ++c) {
      const std::string text = c < row.size() ? row[c] : "";
      const bool word = c >= words.size() || words[c];
      out += cell(text, "", !word ? "" : widthInEms(text) > 24 ? "said" : "word");
    }
    out += "</tr>\n";
  }
  return out + "</tbody></table></div>\n" + paragraph(t.note, "note");
}

std::string chartFigures(const std::vector<Chart>& charts) {
  if (charts.empty()) return "";
  std::string out = "<h2 id=\"charts\">Charts</h2>\n<div class=\"charts\">\n";
  for (const Chart& c : charts) {
    out += "<figure id=\"" + fileWord(c.id) + "\">\n" + svgChart(c);
    if (!c.note.empty()) out += "<figcaption>" + escaped(c.note) + "</figcaption>";
    out += "</figure>\n";
  }
  return out + "</div>\n";
}

std::string pictureFigures(const Report& report, const std::vector<std::string>& data) {
  if (report.pictures.empty()) return "";
  std::string out = "<h2 id=\"pictures\">Pictures</h2>\n<div class=\"charts\">\n";
  for (size_t i = 0; i < report.pictures.size() && i < data.size(); ++i) {
    const Illustration& p = report.pictures[i];
    out += "<figure><img alt=\"" + escaped(p.title) + "\" src=\"" + data[i] + "\"><figcaption><strong>" + escaped(p.title) +
           "</strong> " + escaped(p.note) + "</figcaption></figure>\n";
  }
  return out + "</div>\n";
}

}  // namespace

std::string htmlPage(const Report& report, const std::vector<std::string>& picture_data) {
  std::string out = "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" "
                    "content=\"width=device-width, initial-scale=1\">\n<title>" +
                    escaped(report.title) + "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n<h1>" +
                    escaped(report.title) + "</h1>\n" + paragraph(report.lead, "lead");
  // The command is the last fact, and goes where one looks for how a page was made.
  const bool command = !report.facts.empty() && report.facts.back().first == "command";
  if (const size_t facts = report.facts.size() - (command ? 1 : 0); facts > 0) {
    out += "<table class=\"facts\"><tbody>\n";
    for (size_t i = 0; i < facts; ++i)
      out += "<tr><th scope=\"row\">" + escaped(report.facts[i].first) + "</th><td>" + escaped(report.facts[i].second) +
             "</td></tr>\n";
    out += "</tbody></table>\n";
  }
  out += chartFigures(report.charts) + pictureFigures(report, picture_data) + settingsTable(report.settings);
  for (const Table& t : report.tables) out += tableSection(t);
  if (command) out += "<footer>Made by <code>" + escaped(report.facts.back().second) + "</code></footer>\n";
  return out + "<script>" + kScripts + "</script>\n</body>\n</html>\n";
}

}  // namespace ff::chart
