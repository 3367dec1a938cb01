#include "tools/chart/answer.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <span>
#include <vector>

#include "formats/storage/storage.h"
#include "runtime/choose_solver.h"
#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/front.h"
#include "tools/chart/run_settings_json.h"

namespace ff::chart {
namespace {

struct Candidate {
  size_t setting = 0;
  double error = 0, ms = 0, mib = 0;
};

// NaN after all numbers.
double orLast(double v) { return std::isnan(v) ? std::numeric_limits<double>::infinity() : v; }

std::vector<Candidate> candidatesOf(const Report& report, const Candidates& which) {
  std::vector<Candidate> all;
  for (size_t i = 0; i < report.settings.size(); ++i) {
    const Setting& s = report.settings[i];
    if ((s.bakes_anew && !which.other_bakes) || (s.run.solver.empty() && !which.baselines)) continue;
    const Candidate c{i, errorOf(report, s, "").value, s.relight_ms.value, costOf(s, Cost::kMemoryMiB).value};
    if (std::isfinite(c.error)) all.push_back(c);
  }
  return all;
}

std::string figures(const Report& report, const Candidate& c) {
  const Setting& s = report.settings[c.setting];
  return s.name + ": " + withError(errorOf(report, s, ""), 100) + " % (" + worstLight(report, s) + "), " +
         (std::isfinite(c.ms) ? withError(s.relight_ms) + " ms" : "time not measured") + ", " +
         (std::isfinite(c.mib) ? shortNumber(c.mib) + " MiB" : "memory not measured");
}

// The first of `all` by `before` that `fits`; else why, naming the first by `nearer`.
template <class Fits, class Before, class Nearer>
Answer choose(const Report& report, std::vector<Candidate> all, const std::string& what, Fits fits, Before before, Nearer nearer) {
  if (all.empty()) return {std::nullopt, "nothing " + what + ": no setting that could be chosen has an error in every light"};
  std::stable_sort(all.begin(), all.end(), before);
  for (const Candidate& c : all)
    if (fits(c)) return {c.setting, figures(report, c)};
  const auto nearest = std::min_element(all.begin(), all.end(), nearer);
  return {std::nullopt, "nothing " + what + "; nearest is " + figures(report, *nearest)};
}

}  // namespace

Answer cheapestWithin(const Report& report, double rel_l2, const Candidates& which) {
  std::vector<Candidate> all = candidatesOf(report, which);
  std::erase_if(all, [](const Candidate& c) { return !std::isfinite(c.ms); });
  return choose(
      report, std::move(all), "is within " + shortNumber(100 * rel_l2) + " %", [&](const Candidate& c) { return c.error <= rel_l2; },
      [](const Candidate& a, const Candidate& b) { return a.ms != b.ms ? a.ms < b.ms : orLast(a.mib) < orLast(b.mib); },
      [](const Candidate& a, const Candidate& b) { return a.error < b.error; });
}

Answer bestWithin(const Report& report, double relight_ms, double memory_mib, const Candidates& which) {
  const bool any_ms = std::isinf(relight_ms), any_mib = std::isinf(memory_mib);
  std::vector<Candidate> all = candidatesOf(report, which);
  std::erase_if(all, [&](const Candidate& c) {
    return (!any_ms && !std::isfinite(c.ms)) || (!any_mib && !std::isfinite(c.mib));
  });
  const auto over = [&](const Candidate& c) {
    return std::max(any_ms ? 0 : c.ms / relight_ms, any_mib ? 0 : c.mib / memory_mib);
  };
  const std::string ms = any_ms ? "any time" : shortNumber(relight_ms) + " ms";
  const std::string mib = any_mib ? "any memory" : shortNumber(memory_mib) + " MiB";
  return choose(
      report, std::move(all), "is within " + ms + " and " + mib,
      [&](const Candidate& c) { return (any_ms || c.ms <= relight_ms) && (any_mib || c.mib <= memory_mib); },
      [](const Candidate& a, const Candidate& b) { return a.error != b.error ? a.error < b.error : orLast(a.ms) < orLast(b.ms); },
      [&](const Candidate& a, const Candidate& b) { return over(a) < over(b); });
}

Result<std::string> writeRecommendation(const std::string& world_path, const Report& report, size_t index) {
  const Setting& s = report.settings[index];
  const std::string path = runtime::settingsPath(world_path);
  if (s.run.solver.empty())
    return Error{ErrorCode::kUsage, path, "", "the run time cannot be told \"" + s.name + "\"", "choose another setting"};
  nlohmann::ordered_json json = jsonOf(s.run);
  auto& measured = json["measured"];
  measured["setting"] = s.name;
  const auto put = [&](const char* key, double value) {
    if (std::isfinite(value)) measured[key] = value;
  };
  put("relight_ms", s.relight_ms.value);
  put("memory_bytes", s.memory_bytes);
  for (const Accuracy& a : s.accuracy)
    if (std::isfinite(a.rel_l2.value)) measured["rel_l2"][a.light] = a.rel_l2.value;

  const std::string text = json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  if (auto ok = formats::writeWholeFile(*formats::posixStorage(), path, std::as_bytes(std::span(text))); !ok) return ok.error();
  return path;
}

}  // namespace ff::chart
