// ffbake scene.glb... -o world.ffm: bakes a glTF scene into a world.
#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <span>
#include <string>

#include <fmt/core.h>

#include "bake/bake.h"
#include "bake/import/files.h"
#include "bake/paging.h"
#include "bake/plan/cache.h"
#include "formats/storage/storage.h"
#include "formats/version.h"
#include "tools/bake/mpi_ranks.h"
#include "tools/bake/progress.h"
#include "tools/bake/stop_signals.h"
#include "tools/bake/summary.h"
#include "tools/run_tool.h"

namespace {

using namespace ff;
using Clock = std::chrono::steady_clock;

constexpr uint32_t kMostRays = 16384;  // of a patch, whatever error is asked for

// To stderr, which may be gone.
void say(const std::string& line) { std::fprintf(stderr, "%s\n", line.c_str()); }

int fail(const Error& error) {
  say("ffbake: " + error.line());
  return static_cast<int>(error.code);
}

// PATTERN=NUMBER; the pattern may hold = as well.
Result<std::pair<std::string, float>> readDensity(const std::string& text) {
  const size_t at = text.rfind('=');
  const std::string number = at == std::string::npos ? "" : text.substr(at + 1);
  char* end = nullptr;
  const float density = std::strtof(number.c_str(), &end);
  if (number.empty() || *end != '\0' || at == 0)
    return Error{ErrorCode::kUsage, "--density", "", "\"" + text + "\" is not PATTERN=NUMBER", "--density 'lamp*=2', for one"};
  return std::pair(text.substr(0, at), density);
}

// "2%" or "2": per cent.
Result<float> readError(const std::string& option, const std::string& text) {
  char* end = nullptr;
  const float percent = std::strtof(text.c_str(), &end);
  if (text.empty() || (*end != '\0' && std::string(end) != "%") || !(percent > 0 && percent < 100))
    return Error{ErrorCode::kUsage, option, "", "\"" + text + "\" is not a per cent above 0 and below 100", option + " 2%, for one"};
  return percent / 100;
}

// What the tool itself reads or writes besides the world may not be the world, nor the other way round.
Result<void> checkOutputs(std::span<const std::string> inputs, const std::string& out, const std::string& vdb) {
  const auto same = [](const std::string& a, const std::string& b) {
    std::error_code unknown;
    return a == b || std::filesystem::equivalent(a, b, unknown);
  };
  const auto refused = [](const std::string& file, const char* message) {
    return Error{ErrorCode::kUsage, file, "", message, "name another output"};
  };
  if (const auto storage = formats::storageFor(out); storage != formats::posixStorage())  // an address: only read
    if (auto ok = storage->checkWritable(out); !ok) return ok;
  for (const std::string& scene : inputs) {
    if (same(scene, out)) return refused(out, "the output would take the place of the scene");
    if (same(scene, vdb)) return refused(vdb, "the grids would take the place of the scene");
  }
  if (vdb.empty()) return {};
  if (same(out, vdb)) return refused(vdb, "the grids would take the place of the world");
  if (std::filesystem::is_directory(vdb)) return refused(vdb, "is a folder");
  return formats::posixStorage()->checkWritable(formats::folderOf(vdb));
}

// Where the bake cache lies if nobody says: "town.cache" of "town.ffm".
std::string cacheBeside(const std::string& out) { return (out.ends_with(".ffm") ? out.substr(0, out.size() - 4) : out) + ".cache"; }

int run(int argc, char** argv) {
  CLI::App app{"Bakes a glTF scene into a Formfield world: form factors of every patch, at every level.", "ffbake"};
  std::vector<std::string> scenes;
  std::string out;
  bake::BakeSettings settings;
  bool quiet = false, json = false, no_geometry = false, json_progress = false, no_cache = false, status = false, clean = false;
  std::string cache_folder;
  uint64_t cache_limit = 20'000'000'000;
  app.add_option("scene", scenes, "the scene: .glb or .gltf files of one space, folders of them, or a .json list with where each stands; needed unless --clean is given");
  app.add_option("-o,--output", out, "the world to write, NAME.ffm; shards are written beside it")->required();
  app.add_option("--patch-size", settings.cell_m, "edge of a patch in metres (default: from --patch-budget)")
      ->check(CLI::PositiveNumber);
  CLI::Option* budget = app.add_option("--patch-budget", settings.patch_budget, "about how many patches to make when no size is given")
      ->transform(CLI::AsSizeValue(true))
      ->capture_default_str();
  CLI::Option* preview = app.add_flag("--preview", settings.preview,
                                      "in seconds, to look at: 10k patches, 128 rays and samples, unless these are given; the world says that it is one");
  std::string target_error = "2%";
  CLI::Option* target = app.add_option("--target-error", target_error, "rays are cast until the light that 99 of 100 patches get errs by less")
                            ->capture_default_str();
  CLI::Option* rays = app.add_option("--rays", settings.rays, "so many rays per patch instead, 1 to 65535; with --target-error at most so many")
                          ->default_str("16384 at most");
  CLI::Option* samples = app.add_option("--samples,--quanta", settings.quanta, "Q: samples kept of a row, 1 to 16383; up to 8 times as many where few bright surfaces light it")->capture_default_str();
  app.add_option("--seed", settings.seed, "seed of all sampling")->capture_default_str();
  app.add_option("--threads", settings.threads, "threads (default: all cores); never changes the result");
  app.add_option("--metals", settings.metals, "share of a metal's mirror reflection carried on as diffuse light, 0 to 1")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  bake::ImportLimits import;
  std::string up = "y";
  app.add_option("--exclude,--leave-out", settings.cleanup.exclude,
                 "nodes, meshes and materials, by name (* stands for any text), that take no part: toon outlines, helpers");
  app.add_option("--occlude-only", settings.cleanup.occlude_only, "the same, which block light and have no patches");
  std::vector<std::string> densities;
  app.add_option("--density", densities, "the same, as PATTERN=2: patches 1/2 as long as elsewhere; 0.0625 to 16, rounded to a power of two");
  std::string adaptive;
  CLI::Option* merge =
      app.add_option("--adaptive", adaptive, "patches up to 8 times as long where their albedo and the light that they see differ by no more than this, 2% for one: open ground, large walls")
          ->type_name("ERROR");
  app.add_flag("--keep-sky-dome", settings.cleanup.keep_sky_dome, "bake a dome of pictures of the sky like any surface");
  app.add_option("--backs", settings.cleanup.backs, "what single-sided surfaces do to light from behind: absorb, reflect, pass")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, bake::Backs>{
              {"absorb", bake::Backs::kAbsorb}, {"reflect", bake::Backs::kReflect}, {"pass", bake::Backs::kPass}},
          CLI::ignore_case))
      ->default_str("absorb");
  app.add_option("--scale", import.scale, "metres in a unit of the file: 0.01 for centimetres")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--up", up, "the file's axis that points up: y or z")->check(CLI::IsMember({"y", "z"}))->capture_default_str();
  app.add_option("--memory", settings.memory_bytes, "most memory to take, 2G for one: what does not fit is put into files beside the world; a bake that needs more all the same is refused (default: what is free)")
      ->transform(CLI::AsSizeValue(true));
  app.add_flag("--no-geometry", no_geometry, "leave out the drawing geometry");
  app.add_option("--write-vdb", settings.vdb_path, "also write the occupied chunks, the patches in each cell and the error of their rows as OpenVDB grids")->type_name("FILE.vdb");
  app.add_option("--cache", cache_folder,
                 "where to keep what was done, so that a bake that was stopped goes on and an edit costs what it changes (default: NAME.cache beside the world)")
      ->type_name("FOLDER");
  app.add_option("--cache-limit", cache_limit, "what the cache may take on the disk")->transform(CLI::AsSizeValue(true))->default_str("20G");
  app.add_flag("--no-cache", no_cache, "keep nothing, take nothing from the cache");
  app.add_flag("--status", status, "say what of the bake is done, what an edit has changed, and what is missing; bakes nothing");
  app.add_flag("--clean", clean, "remove the cache; bakes nothing");
  app.add_flag("--quiet", quiet, "no progress");
  app.add_flag("--json-progress", json_progress, "progress as JSON, an object a line on stderr");
  app.add_flag("--json", json, "print what was baked as JSON");
  app.set_version_flag("--version", "ffbake " FF_VERSION);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 1;
  }
  settings.geometry = !no_geometry;
  if (preview->count() > 0) {
    if (budget->count() == 0) settings.patch_budget = 10'000;
    if (samples->count() == 0) settings.quanta = 128;
    if (rays->count() == 0 && target->count() == 0) settings.rays = 128;
  }
  if (target->count() > 0 || (rays->count() == 0 && !settings.preview)) {
    const auto error = readError("--target-error", target_error);
    if (!error) return fail(error.error());
    settings.target_error = *error;
    if (rays->count() == 0) settings.rays = kMostRays;
  }
  if (merge->count() > 0) {
    const auto error = readError("--adaptive", adaptive);
    if (!error) return fail(error.error());
    settings.merge_error = *error;
  }
  import.z_up = up == "z";
  for (const std::string& density : densities) {
    auto read = readDensity(density);
    if (!read) return fail(read.error());
    settings.cleanup.density.push_back(std::move(*read));
  }

  if (cache_folder.empty()) cache_folder = cacheBeside(out);
  if (clean) {
    const auto removed = bake::BakeCache::clean(cache_folder);
    if (!removed) return fail(removed.error());
    fmt::print("{}: {:.1f} MB removed\n", cache_folder, static_cast<double>(*removed) * 1e-6);
    return 0;
  }
  const auto files = bake::sceneFiles(scenes);
  if (!files) return fail(files.error());
  if (status && no_cache) return fail({ErrorCode::kUsage, "--status", "", "there is no cache to look into with --no-cache", ""});
  std::vector<std::string> inputs = scenes;  // lists and folders as well
  for (const bake::SceneFile& file : *files) inputs.push_back(file.path);
  if (auto ok = checkOutputs(inputs, out, settings.vdb_path); !ok) return fail(ok.error());

  std::signal(SIGPIPE, SIG_IGN);  // a reader of stderr that is gone is no reason to end; one of stdout is an error at the end
  tools::StopSignals signals("ffbake");
  auto joined = tools::MpiRanks::join();
  if (!joined) return fail(joined.error());
  const std::unique_ptr<tools::MpiRanks> ranks = std::move(*joined);
  const bool helps = ranks && ranks->rank() > 0;
  const auto leave = [&](int code) {
    if (ranks) ranks->leave(code);
    return code;
  };
  if (ranks && (no_cache || status))
    return leave(fail({ErrorCode::kUsage, no_cache ? "--no-cache" : "--status", "", "is for one process", "start it without mpirun"}));
  using Style = tools::ProgressPrinter::Style;
  tools::ProgressPrinter printer(helps ? Style::kQuiet : json_progress ? Style::kJson : quiet ? Style::kQuiet : Style::kBar);
  import.progress = [&, last = Clock::time_point{}](uint64_t done, uint64_t total) mutable {
    if (done < total && Clock::now() - last < std::chrono::milliseconds(100)) return;
    last = Clock::now();
    printer("import", done, total);
  };
  const bake::Paging paging(formats::folderOf(out), settings.memory_bytes);
  auto scene = bake::importFiles(*files, import);
  printer.endLine();
  if (!scene) return leave(fail(scene.error()));
  if (!helps)
    for (const std::string& warning : scene->warnings) say("ffbake: warning: " + warning);
  settings.announce = [&](const bake::BakeEstimate& e) {
    if (!quiet && !json_progress)
      say(fmt::format("estimate  about {:.2g} patches of {:.3g} m: {:.2g} GB of memory, {:.2g} GB on disk, {:.0f} min", e.patches, e.cell_m,
                      e.memory_bytes * 1e-9, e.disk_bytes * 1e-9, std::ceil(e.seconds / 60)));
  };
  std::unique_ptr<bake::BakeCache> cache;
  if (!no_cache) {
    auto opened = status ? bake::BakeCache::peek(cache_folder) : bake::BakeCache::open(cache_folder, helps ? ~uint64_t{0} : cache_limit);  // rank 0 keeps to the limit
    if (!opened) return leave(fail(opened.error()));
    cache = std::move(*opened);
    settings.cache = cache.get();
  }
  settings.stop = signals.flag();
  signals.beginWork(helps ? "" : cache ? "stopped; the same command goes on from here (what was done is in " + cache_folder + ")"
                          : "stopped; without a cache the next bake begins anew");
  const bake::Progress progress = [&](const char* phase, uint64_t done, uint64_t total) { printer(phase, done, total); };
  const auto failed = [&](const Error& error) { return error.cause == ErrorCause::kStopped ? signals.stopped() : fail(error); };
  settings.ranks = ranks.get();
  if (helps) {
    const auto helped = bake::helpBake(*scene, settings);
    return leave(helped ? 0 : failed(helped.error()));
  }
  if (status) {
    const auto found = bake::bakeStatus(*scene, settings, progress);
    printer.endLine();
    if (!found) return failed(found.error());
    if (json) fmt::print("{}\n", tools::toJson(*found, cache->bytes()).dump());
    else tools::printStatus(*found, out, cache->bytes());
    return 0;
  }
  auto stats = bake::bakeWorld(*scene, settings, out, progress);
  printer.endLine();
  if (!stats) return leave(failed(stats.error()));
  for (const std::string& warning : tools::warningsOf(*stats)) say("ffbake: warning: " + warning);
  const uint64_t cache_bytes = cache ? cache->bytes() : 0;
  if (json) fmt::print("{}\n", tools::toJson(*stats, printer.phases(), cache_bytes).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
  else tools::printSummary(*stats, out, printer.phases(), cache_bytes);
  return leave(0);
}

}  // namespace

int main(int argc, char** argv) { return ff::tools::runTool("ffbake", argc, argv, run); }
