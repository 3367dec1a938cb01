// ffbake scene.glb -o world.ffm: bakes a glTF scene into a world.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <map>
#include <nlohmann/json.hpp>
#include <string>

#include <fmt/core.h>

#include "bake/bake.h"
#include "bake/import/gltf_import.h"
#include "formats/version.h"

namespace {

using Clock = std::chrono::steady_clock;

// A bar with the time left on a terminal; one plain line a phase elsewhere.
class ProgressPrinter {
 public:
  explicit ProgressPrinter(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) == 1) {}
  ~ProgressPrinter() { endLine(); }

  void operator()(const char* phase, uint64_t done, uint64_t total) {
    if (quiet_) return;
    if (phase_ != phase) {
      endLine();
      phase_ = phase;
      began_ = Clock::now();
      said_done_ = false;
    }
    const double seconds = std::chrono::duration<double>(Clock::now() - began_).count();
    if (terminal_) {
      const double share = total > 0 ? static_cast<double>(done) / static_cast<double>(total) : 0;
      const auto filled = static_cast<size_t>(share * 30);
      std::string eta = "      ";
      if (share > 0 && share < 1 && seconds > 0.5) eta = fmt::format("{:4.0f} s left", seconds * (1 - share) / share);
      fmt::print(stderr, "\r{:<9} [{:<30}] {:3.0f} %  {:<12}", phase, std::string(filled, '#'), share * 100, eta);
      std::fflush(stderr);
      open_ = true;
    } else if (done == total && !said_done_) {
      said_done_ = true;
      fmt::print(stderr, "{:<9} {:>10} done in {:.1f} s\n", phase, total, seconds);
    }
  }
  void endLine() {
    if (open_) fmt::print(stderr, "\n");
    open_ = false;
  }

 private:
  bool quiet_, terminal_, open_ = false, said_done_ = false;
  std::string phase_;
  Clock::time_point began_;
};

int fail(const ff::Error& error) {
  fmt::print(stderr, "ffbake: {}\n", error.line());
  return static_cast<int>(error.code);
}

// PATTERN=NUMBER; the pattern may hold = as well.
ff::Result<std::pair<std::string, float>> readDensity(const std::string& text) {
  const size_t at = text.rfind('=');
  const std::string number = at == std::string::npos ? "" : text.substr(at + 1);
  char* end = nullptr;
  const float density = std::strtof(number.c_str(), &end);
  if (number.empty() || *end != '\0' || at == 0)
    return ff::Error{ff::ErrorCode::kUsage, "--density", "", "\"" + text + "\" is not PATTERN=NUMBER", "--density 'lamp*=2', for one"};
  return std::pair(text.substr(0, at), density);
}

void printSummary(const ff::bake::BakeStats& s, const std::string& out) {
  uint64_t bytes = 0;
  for (const auto& l : s.levels) bytes += l.stored_bytes;
  fmt::print("{}: {} patches of {:.4g} m, {} levels, {:.1f} MB of rows\n", out, s.levels[0].nodes, static_cast<double>(s.cell_m),
             s.levels.size(), static_cast<double>(bytes) * 1e-6);
  fmt::print("  {:>5} {:>9} {:>6} {:>12} {:>11}\n", "level", "nodes", "tiles", "entries/row", "bytes/node");
  for (size_t l = 0; l < s.levels.size(); ++l) {
    const auto& v = s.levels[l];
    fmt::print("  {:>5} {:>9} {:>6} {:>12.1f} {:>11.1f}\n", l, v.nodes, v.tiles,
               static_cast<double>(v.entries) / v.nodes, static_cast<double>(v.stored_bytes) / v.nodes);
  }
  fmt::print("  sky {:.1f} %, absorbed by back faces {:.2f} % of all light paths; {:.1f} % of the surface lies inside solids\n",
             s.sky_fraction * 100, s.absorbed_fraction * 100, s.buried_fraction * 100);
  fmt::print("  {:.1f} s, {:.2f} million rays a second over the whole bake\n", s.seconds,
             static_cast<double>(s.rays) * 1e-6 / s.seconds);
}

// Names are the file's own: control characters do not reach the terminal.
std::string shown(std::string name) {
  for (char& c : name)
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  return name;
}

// The last block: nothing where there is nothing to say.
void printNotModelled(const std::vector<ff::bake::NotModelled>& lines) {
  constexpr size_t kMaxNames = 8;
  if (!lines.empty()) fmt::print("not modelled here\n");
  for (const auto& line : lines) {
    fmt::print("  {}\n", shown(line.what));
    if (line.names.empty()) continue;
    fmt::print("    {} {}, {} triangles, {:.3g} % of the surface:", line.names.size(),
               line.names.size() == 1 ? "material" : "materials", line.triangles, line.area_share * 100);
    for (size_t i = 0; i < std::min(kMaxNames, line.names.size()); ++i)
      fmt::print("{} {}", i == 0 ? "" : ",", shown(line.names[i]));
    if (line.names.size() > kMaxNames) fmt::print(" and {} more", line.names.size() - kMaxNames);
    fmt::print("\n");
  }
}

nlohmann::json toJson(const std::vector<ff::bake::NotModelled>& lines) {
  nlohmann::json out = nlohmann::json::array();
  for (const auto& line : lines)
    out.push_back({{"what", line.what}, {"triangles", line.triangles}, {"area_share", line.area_share}, {"materials", line.names}});
  return out;
}

nlohmann::json toJson(const ff::bake::BakeStats& s) {
  nlohmann::json levels = nlohmann::json::array();
  for (const auto& l : s.levels)
    levels.push_back({{"nodes", l.nodes}, {"tiles", l.tiles}, {"entries", l.entries}, {"stored_bytes", l.stored_bytes}});
  return {{"cell_m", s.cell_m},       {"triangles", s.triangles},
          {"area_m2", s.area_m2},     {"rays", s.rays},
          {"sky_fraction", s.sky_fraction}, {"absorbed_fraction", s.absorbed_fraction},
          {"buried_fraction", s.buried_fraction},
          {"clamped_nodes", s.clamped_nodes},
          {"triangles_without_area", s.without_area},
          {"warnings", s.warnings},
          {"not_modelled", toJson(s.not_modelled)},
          {"ray_seconds", s.ray_seconds},   {"seconds", s.seconds},
          {"levels", levels}};
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Bakes a glTF scene into a Formfield world: form factors of every patch, at every level.", "ffbake"};
  std::string scene_path, out;
  ff::bake::BakeSettings settings;
  std::string budget = "60k";
  bool quiet = false, json = false, no_geometry = false;
  app.add_option("scene", scene_path, "the scene: .glb or .gltf")->required();
  app.add_option("-o,--output", out, "the world to write, NAME.ffm; shards are written beside it")->required();
  app.add_option("--patch-size", settings.cell_m, "edge of a patch in metres (default: from --patch-budget)")
      ->check(CLI::PositiveNumber);
  app.add_option("--patch-budget", settings.patch_budget, "about how many patches to make when no size is given")
      ->transform(CLI::AsSizeValue(true))
      ->capture_default_str();
  app.add_option("--rays", settings.rays, "rays per patch, 1 to 65535")->capture_default_str();
  app.add_option("--samples,--quanta", settings.quanta, "Q: samples kept of a row, 1 to 65535; up to 8 times as many where few bright surfaces light it")->capture_default_str();
  app.add_option("--seed", settings.seed, "seed of all sampling")->capture_default_str();
  app.add_option("--threads", settings.threads, "threads (default: all cores); never changes the result");
  app.add_option("--metals", settings.metals, "share of a metal's mirror reflection carried on as diffuse light, 0 to 1")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  ff::bake::ImportLimits import;
  std::string up = "y";
  app.add_option("--exclude,--leave-out", settings.cleanup.exclude,
                 "nodes, meshes and materials, by name (* stands for any text), that take no part: toon outlines, helpers");
  app.add_option("--occlude-only", settings.cleanup.occlude_only, "the same, which block light and have no patches");
  std::vector<std::string> densities;
  app.add_option("--density", densities, "the same, as PATTERN=2: patches 1/2 as long as elsewhere; 0.0625 to 16, rounded to a power of two");
  app.add_flag("--keep-sky-dome", settings.cleanup.keep_sky_dome, "bake a dome of pictures of the sky like any surface");
  app.add_option("--backs", settings.cleanup.backs, "what single-sided surfaces do to light from behind: absorb, reflect, pass")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, ff::bake::Backs>{
              {"absorb", ff::bake::Backs::kAbsorb}, {"reflect", ff::bake::Backs::kReflect}, {"pass", ff::bake::Backs::kPass}},
          CLI::ignore_case))
      ->default_str("absorb");
  app.add_option("--scale", import.scale, "metres in a unit of the file: 0.01 for centimetres")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--up", up, "the file's axis that points up: y or z")->check(CLI::IsMember({"y", "z"}))->capture_default_str();
  app.add_option("--memory", settings.memory_bytes, "a bake that would need more is refused: 16G (default: what is free)")
      ->transform(CLI::AsSizeValue(true));
  app.add_flag("--no-geometry", no_geometry, "leave out the drawing geometry");
  app.add_option("--write-vdb", settings.vdb_path, "also write the occupied chunks, and the patches in each cell, as OpenVDB grids")->type_name("FILE.vdb");
  app.add_flag("--quiet", quiet, "no progress");
  app.add_flag("--json", json, "print what was baked as JSON");
  app.set_version_flag("--version", "ffbake " FF_VERSION);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 1;
  }
  settings.geometry = !no_geometry;
  import.z_up = up == "z";
  for (const std::string& density : densities) {
    auto read = readDensity(density);
    if (!read) return fail(read.error());
    settings.cleanup.density.push_back(std::move(*read));
  }

  ProgressPrinter printer(quiet);
  import.progress = [&, last = Clock::time_point{}](uint64_t done, uint64_t total) mutable {
    if (done < total && Clock::now() - last < std::chrono::milliseconds(100)) return;
    last = Clock::now();
    printer("import", done, total);
  };
  auto scene = ff::bake::importGltf(scene_path, import);
  printer.endLine();
  if (!scene) return fail(scene.error());
  settings.announce = [&](const ff::bake::BakeEstimate& e) {
    if (!quiet)
      fmt::print(stderr, "estimate  about {:.2g} patches of {:.3g} m: {:.2g} GB of memory, {:.2g} GB on disk, {:.0f} min\n", e.patches, e.cell_m,
                 e.memory_bytes * 1e-9, e.disk_bytes * 1e-9, std::ceil(e.seconds / 60));
  };
  for (const std::string& warning : scene->warnings) fmt::print(stderr, "ffbake: warning: {}\n", warning);
  auto stats = ff::bake::bakeWorld(*scene, settings, out,
                                   [&](const char* phase, uint64_t done, uint64_t total) { printer(phase, done, total); });
  printer.endLine();
  if (!stats) return fail(stats.error());
  for (const std::string& warning : stats->warnings) fmt::print(stderr, "ffbake: warning: {}\n", warning);
  if (json) {
    fmt::print("{}\n", toJson(*stats).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
  } else {
    printSummary(*stats, out);
    printNotModelled(stats->not_modelled);
  }
  return 0;
}
