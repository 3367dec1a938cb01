#include "tools/chart/page/json_report.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "tools/chart/page/setting_figures.h"
#include "tools/chart/run_settings_json.h"

namespace ff::chart {
namespace {

using Json = nlohmann::ordered_json;

Json numberOrNull(double v) { return std::isfinite(v) ? Json(v) : Json(nullptr); }

// As in the CSV a figure is two values: it and its error.
struct Fields {
  Json json = Json::object();
  void operator()(const char* name, const std::string& text) { json[name] = text; }
  void operator()(const char* name, bool flag) { json[name] = flag; }
  void operator()(const char* name, double value) { json[name] = numberOrNull(value); }
  void operator()(const char* name, const Figure& f) {
    json[name] = numberOrNull(f.value);
    json[std::string(name) + "_error"] = numberOrNull(std::isfinite(f.value) ? f.error : kNotMeasured);
  }
};

template <class Value>
Json fieldsOf(const Value& value) {
  Fields fields;
  eachFigure(value, fields);
  return fields.json;
}

Json jsonOf(const Setting& s);
Json jsonOf(const ErrorSources& split);
Json jsonOf(const ErrorSources::Source& s);
Json jsonOf(const SeenScore& s);
Json jsonOf(const Measured& m);
Json jsonOf(const Measured::Point& p);
Json jsonOf(const Chart& c);
Json jsonOf(const Series& s);
Json jsonOf(const Series::Point& p);
Json jsonOf(const Table& t);
Json jsonOf(const Illustration& p);

template <class Value>
Json listOf(const std::vector<Value>& values) {
  Json list = Json::array();
  for (const Value& v : values) list.push_back(jsonOf(v));
  return list;
}

Json namedTexts(const std::vector<std::pair<std::string, std::string>>& texts) {
  Json json = Json::object();
  for (const auto& [name, text] : texts) {
    // Two scenes, two facts of that name.
    if (json.contains(name))
      json[name] = json[name].get<std::string>() + "; " + text;
    else
      json[name] = text;
  }
  return json;
}

Json jsonOf(const Setting& s) {
  Json json = fieldsOf(s);
  json["accuracy"] = Json::array();
  for (const Accuracy& a : s.accuracy) json["accuracy"].push_back(fieldsOf(a));
  json["knobs"] = namedTexts(s.knobs);
  json["world"] = s.world.empty() ? Json(nullptr) : Json(s.world);
  json["run"] = s.run.solver.empty() ? Json(nullptr) : jsonOf(s.run);
  json["note"] = s.note;
  return json;
}

Json jsonOf(const ErrorSources::Source& s) {
  Fields fields;
  fields("source", s.source);
  fields("rel_l2", s.error);
  fields("measured_as", s.measured_as);
  return fields.json;
}

Json jsonOf(const ErrorSources& split) {
  return {{"light", split.light}, {"places", split.places}, {"sources", listOf(split.sources)}};
}

// energy of both is the bias.
Json jsonOf(const SeenScore& s) {
  Json json = {{"light", s.light}, {"eyes", s.eyes}, {"pixels", s.pixels}, {"patches", s.patches}, {"note", s.note}};
  json["not_drawn"] = numberOrNull(s.not_drawn);
  json["own_median"] = numberOrNull(s.own_median);
  json["tracer_noise"] = numberOrNull(s.tracer_noise);
  json["streamed"] = fieldsOf(s.streamed);
  json["full_solve"] = fieldsOf(s.full_solve);
  return json;
}

Json jsonOf(const Measured::Point& p) { return {{"at", numberOrNull(p.at)}, {"error", numberOrNull(p.error)}}; }

Json jsonOf(const Measured& m) {
  return {{"scene", m.scene}, {"method", m.method},         {"knob", m.knob},
          {"unit", m.unit},   {"points", listOf(m.points)}, {"then", m.then}};
}

Json jsonOf(const Series::Point& p) {
  return {{"x", numberOrNull(p.x)},
          {"x_error", numberOrNull(p.x_error)},
          {"y", numberOrNull(p.y)},
          {"y_error", numberOrNull(p.y_error)},
          {"hover", p.hover}};
}

Json jsonOf(const Series& s) { return {{"name", s.name}, {"points", listOf(s.points)}}; }

Json jsonOf(const Chart& c) {
  return {{"id", c.id},     {"title", c.title},           {"x_label", c.x_label}, {"y_label", c.y_label},
          {"note", c.note}, {"series", listOf(c.series)}};
}

Json jsonOf(const Table& t) {
  return {{"id", t.id}, {"title", t.title}, {"note", t.note}, {"columns", t.columns}, {"rows", t.rows}};
}

Json jsonOf(const Illustration& p) { return {{"file", p.file}, {"title", p.title}, {"note", p.note}}; }

Json jsonOf(const Answered& a, const Report& report) {
  Json json;
  json["asked"] = a.asked;
  if (a.rel_l2) json["at_most_rel_l2"] = numberOrNull(*a.rel_l2);
  if (a.relight_ms) json["at_most_relight_ms"] = numberOrNull(*a.relight_ms);
  if (a.memory_mib) json["at_most_memory_mib"] = numberOrNull(*a.memory_mib);
  json["setting"] = a.answer.setting ? Json(report.settings[*a.answer.setting].name) : Json(nullptr);
  json["line"] = a.answer.line;
  json["written"] = a.written.empty() ? Json(nullptr) : Json(a.written);
  return json;
}

Json jsonOf(const JsonPage& page) {
  const Report& r = page.report;
  Json json;
  json["page"] = page.file;
  json["title"] = r.title;
  json["lead"] = r.lead;
  json["facts"] = namedTexts(r.facts);
  json["answers"] = Json::array();
  for (const Answered& a : page.answers) json["answers"].push_back(jsonOf(a, r));
  json["settings"] = listOf(r.settings);
  json["sources"] = listOf(r.sources);
  json["seen"] = listOf(r.seen);
  json["cases"] = listOf(r.cases);
  json["tables"] = listOf(r.tables);
  json["charts"] = listOf(r.charts);
  json["pictures"] = listOf(r.pictures);
  return json;
}

}  // namespace

std::string jsonDocument(const std::string& version, const std::string& command, const std::vector<JsonPage>& pages) {
  Json document;
  document["version"] = version;
  document["command"] = command;
  for (const JsonPage& page : pages) document[page.name] = jsonOf(page);
  return document.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace ff::chart
