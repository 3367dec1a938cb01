#include "tools/bake/summary.h"

#include <fmt/core.h>
#include <sys/resource.h>

#include <algorithm>
#include <utility>

namespace ff::tools {
namespace {

// Names are the file's own: control characters do not reach the terminal.
std::string shown(std::string name) {
  for (char& c : name)
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  return name;
}

// The last block: nothing where there is nothing to say.
void printNotModelled(const std::vector<bake::Finding>& findings) {
  constexpr size_t kMaxNames = 8;
  const char* title = "not modelled here\n";
  for (const bake::Finding& f : findings) {
    if (f.kind != "not_modelled") continue;
    fmt::print("{}  {}\n", std::exchange(title, ""), shown(f.what));
    if (f.places.empty()) continue;
    fmt::print("    {} {}, {} triangles, {:.3g} % of the surface: ", f.places.size(), f.places.size() == 1 ? "material" : "materials", f.count, f.share * 100);
    for (size_t i = 0; i < std::min(kMaxNames, f.places.size()); ++i) {
      const bake::FoundPlace& place = f.places[i];
      fmt::print("{}{}{}", i == 0 ? "" : ", ", shown(place.name), place.at && i < bake::kMaxPlaces ? " (at " + bake::textOf(*place.at) + ")" : "");
    }
    if (f.places.size() > kMaxNames) fmt::print(" and {} more", f.places.size() - kMaxNames);
    fmt::print("\n");
  }
}

nlohmann::json toJson(const std::vector<bake::Finding>& findings) {
  nlohmann::json out = nlohmann::json::array();
  for (const bake::Finding& f : findings) {
    nlohmann::json places = nlohmann::json::array();
    for (const bake::FoundPlace& place : f.places) {
      nlohmann::json entry{{"name", place.name}, {"share", place.share}};
      if (place.at) entry["at"] = *place.at;
      places.push_back(std::move(entry));
    }
    out.push_back({{"kind", f.kind}, {"what", f.what}, {"count", f.count}, {"counted", f.counted}, {"share", f.share}, {"share_of", f.share_of},
                   {"places", places}, {"more_places", f.more_places}, {"remedy", f.remedy}});
  }
  return out;
}

nlohmann::json toJson(const bake::CachedRays& cached) {
  const auto& [clean, stale, missing] = cached.rows;
  return {{"clean", clean}, {"stale", stale}, {"missing", missing}, {"by_other_ranks", cached.by_others},
          {"light_of_lamps", {{"clean", cached.lamps.clean}, {"stale", cached.lamps.stale}, {"missing", cached.lamps.missing}}}};
}

}  // namespace

std::vector<std::string> warningsOf(const bake::BakeStats& stats) {
  std::vector<std::string> lines;
  for (const bake::Finding& f : stats.findings)
    if (f.kind != "not_modelled") lines.push_back(shown(lineOf(f)));
  lines.insert(lines.end(), stats.warnings.begin(), stats.warnings.end());
  return lines;
}

uint64_t peakBytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<uint64_t>(usage.ru_maxrss) << 10;
}

void printSummary(const bake::BakeStats& s, const std::string& world, const PhaseTimes& phases, uint64_t cache_bytes) {
  uint64_t bytes = 0;
  for (const auto& l : s.levels) bytes += l.stored_bytes;
  fmt::print("{}: {} patches of {:.4g} m, {} levels, {:.1f} MB of rows\n", world, s.levels[0].nodes, static_cast<double>(s.cell_m),
             s.levels.size(), static_cast<double>(bytes) * 1e-6);
  fmt::print("  {:>5} {:>9} {:>6} {:>12} {:>11}\n", "level", "nodes", "tiles", "entries/row", "bytes/node");
  for (size_t l = 0; l < s.levels.size(); ++l) {
    const auto& v = s.levels[l];
    fmt::print("  {:>5} {:>9} {:>6} {:>12.1f} {:>11.1f}\n", l, v.nodes, v.tiles,
               static_cast<double>(v.entries) / v.nodes, static_cast<double>(v.stored_bytes) / v.nodes);
  }
  if (s.unmerged_patches > 0)
    fmt::print("  merged: {} patches were {}, {:.1f} % less; {} are up to 2 cells wide, {} 4, {} 8\n", s.levels[0].nodes, s.unmerged_patches,
               100 * (1 - static_cast<double>(s.levels[0].nodes) / static_cast<double>(s.unmerged_patches)), s.merged_patches[0], s.merged_patches[1],
               s.merged_patches[2]);
  fmt::print("  sky {:.1f} %, absorbed by back faces {:.2f} % of all light paths; {:.1f} % of the surface lies inside solids\n",
             s.sky_fraction * 100, s.absorbed_fraction * 100, s.buried_fraction * 100);
  fmt::print("  {} rays a patch (at least {}), which leave an error of at most {:.2g} % in the light that 99 of 100 patches get\n", s.mean_rays, s.fewest_rays,
             static_cast<double>(s.row_error) * 100);
  fmt::print("  {:.1f} s, {:.2f} million rays a second over the whole bake; {:.2g} GB of memory at most", s.seconds,
             static_cast<double>(s.cast_rays) * 1e-6 / s.seconds, static_cast<double>(peakBytes()) * 1e-9);
  if (s.spilled_bytes > 0) fmt::print(", and {:.2g} GB in files that are gone again", static_cast<double>(s.spilled_bytes) * 1e-9);
  fmt::print("\n");
  fmt::print("  seconds:");
  for (const auto& [phase, seconds] : phases) fmt::print(" {} {:.1f}", phase, seconds);
  fmt::print("\n");
  if (cache_bytes > 0) {
    fmt::print("  the rows of {} of {} patches were in the cache, and the light of lamps of {}; it holds {:.1f} MB now\n", s.cached.rows.clean,
               s.cached.patches(), s.cached.lamps.clean, static_cast<double>(cache_bytes) * 1e-6);
    if (s.cached.by_others > 0) fmt::print("  those of {} were cast by other ranks\n", s.cached.by_others);
  }
  printNotModelled(s.findings);
}

nlohmann::json toJson(const bake::BakeStats& s, const PhaseTimes& phases, uint64_t cache_bytes) {
  nlohmann::json levels = nlohmann::json::array(), seconds_by_phase = nlohmann::json::object();
  for (const auto& l : s.levels)
    levels.push_back({{"nodes", l.nodes}, {"tiles", l.tiles}, {"entries", l.entries}, {"stored_bytes", l.stored_bytes}});
  for (const auto& [phase, seconds] : phases) seconds_by_phase[phase] = seconds;
  return {{"cell_m", s.cell_m},       {"triangles", s.triangles},
          {"area_m2", s.area_m2},     {"rays", s.rays}, {"rays_cast", s.cast_rays}, {"fewest_rays", s.fewest_rays}, {"row_error", s.row_error},
          {"spilled_bytes", s.spilled_bytes},
          {"sky_fraction", s.sky_fraction}, {"absorbed_fraction", s.absorbed_fraction},
          {"buried_fraction", s.buried_fraction},
          {"clamped_nodes", s.clamped_nodes},
          {"unmerged_patches", s.unmerged_patches}, {"merged_patches", s.merged_patches},
          {"triangles_without_area", s.without_area},
          {"warnings", s.warnings},
          {"findings", toJson(s.findings)},
          {"ray_seconds", s.ray_seconds},   {"seconds", s.seconds},
          {"seconds_by_phase", seconds_by_phase}, {"peak_bytes", peakBytes()},
          {"cached_patches", toJson(s.cached)}, {"cache_bytes", cache_bytes},
          {"levels", levels}};
}

void printStatus(const bake::BakeStatus& s, const std::string& world, uint64_t cache_bytes) {
  constexpr size_t kMostPlaces = 5;
  fmt::print("{}: {} patches of {:.4g} m; the cache holds {:.1f} MB\n", world, s.patches, static_cast<double>(s.cell_m), static_cast<double>(cache_bytes) * 1e-6);
  fmt::print("  rows: of {} patches {} are clean; {} are stale, as something has changed where their rays went; {} are missing, as their surface\n"
             "        or the settings were never cast before\n",
             s.cached.patches(), s.cached.rows.clean, s.cached.rows.stale, s.cached.rows.missing);
  fmt::print("  light of lamps: that of {} is clean; of {} it is stale, as a lamp that may light them has changed, or something on the way to it, or what their\n"
             "        rows meet; of {} it is missing, as their rows are\n",
             s.cached.lamps.clean, s.cached.lamps.stale, s.cached.lamps.missing);
  fmt::print("  patches, pyramid, strips, geometry: always made anew\n");
  if (s.changed.empty()) return;
  fmt::print("  changed since the last bake: {} cubes, around", s.changed.size());
  for (size_t i = 0; i < std::min(kMostPlaces, s.changed.size()); ++i) {
    const Vec3 at = s.changed[i * s.changed.size() / std::min(kMostPlaces, s.changed.size())];
    fmt::print("{} ({:.4g}, {:.4g}, {:.4g})", i == 0 ? "" : ",", static_cast<double>(at.x), static_cast<double>(at.y), static_cast<double>(at.z));
  }
  fmt::print(" m\n");
}

nlohmann::json toJson(const bake::BakeStatus& s, uint64_t cache_bytes) {
  nlohmann::json changed = nlohmann::json::array();
  for (const Vec3& at : s.changed) changed.push_back({at.x, at.y, at.z});
  return {{"cell_m", s.cell_m}, {"patches", s.patches}, {"cached_patches", toJson(s.cached)}, {"changed", changed}, {"cache_bytes", cache_bytes}};
}

}  // namespace ff::tools
