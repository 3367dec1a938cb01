#include <fmt/core.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <chrono>

#include "formats/read/whole_world.h"
#include "tools/inspect/inspect.h"
#include "tools/inspect/world_check.h"

namespace ff::tools {
namespace {

constexpr size_t kMaxFindings = 20;  // printed of each kind; all are counted

// One line on a terminal, nothing elsewhere.
class VerifyBar {
 public:
  explicit VerifyBar(bool quiet) : shown_(!quiet && isatty(STDERR_FILENO) == 1) {}
  void operator()(double fraction) {
    const auto now = std::chrono::steady_clock::now();
    if (!shown_ || now - last_ < std::chrono::milliseconds(200)) return;
    last_ = now;
    const double seconds = std::chrono::duration<double>(now - begin_).count();
    fmt::print(stderr, "\rverify {:5.1f} %  {:.0f} s left ", 100 * fraction, seconds * (1 - fraction) / fraction);
  }
  ~VerifyBar() {
    if (shown_) fmt::print(stderr, "\r{:40}\r", "");
  }

 private:
  bool shown_;
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now(), last_ = begin_;
};

nlohmann::json toJson(const formats::WholeWorld& world, const PairCheck& p) {
  return {{"level", p.level}, {"i", nodeText(world, p.level, p.i)}, {"j", nodeText(world, p.level, p.j)},        {"x_ij_m2", p.x_ij},
          {"x_ji_m2", p.x_ji}, {"allowed_m2", p.bound}, {"of_allowed", p.ratio()}};
}

nlohmann::json toJson(const std::vector<Error>& errors) {
  nlohmann::json list = nlohmann::json::array();
  for (const Error& e : errors)
    list.push_back({{"file", e.file}, {"place", e.place}, {"message", e.message}, {"remedy", e.remedy}});
  return list;
}

void printFindings(std::FILE* to, const std::vector<Error>& errors) {
  for (size_t i = 0; i < errors.size() && i < kMaxFindings; ++i) fmt::print(to, "  {}\n", errors[i].line());
  if (errors.size() > kMaxFindings) fmt::print(to, "  ... and {} more\n", errors.size() - kMaxFindings);
}

}  // namespace

Result<void> inspectVerify(const formats::WholeWorld& world, int threads, bool quiet, const InspectOutput& out) {
  WorldCheck check;
  {
    VerifyBar progress(quiet);
    check = checkWorld(world, threads, [&](double f) { progress(f); });
  }
  const bool ok = check.corrupt.empty() && check.unphysical.empty();
  if (out.json) {
    nlohmann::json worst = nlohmann::json::array();
    for (const PairCheck& p : check.worst_pairs) worst.push_back(toJson(world, p));
    fmt::print(out.to, "{}\n",
               nlohmann::json{{"ok", ok},
                              {"strips", check.strips},
                              {"entries", check.entries},
                              {"pairs", check.pairs},
                              {"geometry_tiles", check.geometry_tiles},
                              {"worst_pairs", worst},
                              {"worst_area_difference", check.worst_area},
                              {"worst_emission_difference", check.worst_emission},
                              {"worst_lamp_difference", check.worst_lamps},
                              {"worst_sky_of_allowed", check.worst_sky},
                              {"row_total_deviation", world.info().row_total_deviation},
                              {"corrupt", toJson(check.corrupt)},
                              {"unphysical", toJson(check.unphysical)}}
                   .dump());
  } else {
    fmt::print(out.to, "strips       {} read, {} damaged\n", check.strips, check.corrupt.size());
    fmt::print(out.to, "closure      exact in {} entries\n", check.entries);
    for (const PairCheck& p : check.worst_pairs)
      fmt::print(out.to, "reciprocity  level {}: worst pair {} and {}: {:.6g} and {:.6g} m2, {:.0f} % of what sampling allows\n",
                 p.level, nodeText(world, p.level, p.i), nodeText(world, p.level, p.j), p.x_ij, p.x_ji, 100 * p.ratio());
    fmt::print(out.to, "sky          counts within {:.0f} % of what sampling allows\n", 100 * check.worst_sky);
    fmt::print(out.to, "pyramid      areas within {:.1e}, emission within {:.1e}, lamps' light within {:.1e} of their children's sums\n",
               check.worst_area, check.worst_emission, check.worst_lamps);
    if (check.geometry_tiles > 0) fmt::print(out.to, "geometry     {} tiles read\n", check.geometry_tiles);
    printFindings(out.to, check.corrupt);
    printFindings(out.to, check.unphysical);
    fmt::print(out.to, "{}\n", ok ? "ok" : "FAILED");
  }
  const std::vector<Error>& worst = check.corrupt.empty() ? check.unphysical : check.corrupt;
  if (!ok) return worst.front();
  return {};
}

}  // namespace ff::tools
