#include "tools/chart/paper/paper.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <utility>

#include "bake/import/gltf_import.h"
#include "formats/read/whole_world.h"
#include "tools/chart/baked_scene.h"
#include "tools/chart/page/figure_text.h"
#include "tools/chart/paper/methods.h"
#include "tools/chart/scene_of_model.h"
#include "tools/chart/stability/breaking_point.h"
#include "tools/scene/town.h"

namespace ff::chart {
namespace {

// What the paper prints. Its difference is "in average less than 0.05", its full matrix's time is an estimate.
constexpr double kPaperPatches = 63125, kPaperDifference = 0.05;
constexpr const char* kPaperLocal = "2 ms, 128 MB";
constexpr const char* kPaperFull = "300 ms, 30 GB (estimated)";
constexpr size_t kObservers = 2;  // a matrix of 4096 takes the seed's method most of a minute to fill
constexpr double kTexel = 8;      // bytes of RGBA16F

std::string mib(double bytes) { return shortNumber(bytes / (1 << 20)) + " MiB"; }
std::string gib(double bytes) { return shortNumber(bytes / (1 << 30)) + " GiB"; }

// Small local matrices may have no patch that near.
std::string innerText(const MethodCost& m) {
  return m.inner.reflected_truth > 0 ? percentText(m.inner.relative()) : kNotMeasuredText;
}

// Means over observers at one size of the local matrix.
struct Size {
  uint32_t most = 0;  // M
  std::vector<MethodCost> methods{};
  double bytes_per_s = 0;
  int observers = 0;
  double worst_picture = 0, worst_linear = 0;  // of the exact local matrix
};

void addTo(Size& size, const MethodsThere& there) {
  if (size.methods.empty()) {
    size.methods = there.methods;
    size.bytes_per_s = there.bytes_per_s;
  } else {
    for (size_t m = 0; m < size.methods.size(); ++m) {
      MethodCost& sum = size.methods[m];
      const MethodCost& one = there.methods[m];
      sum.patches += one.patches;
      sum.nodes += one.nodes;
      sum.linear += one.linear;
      sum.picture += one.picture;
      sum.inner += one.inner;
      sum.relight_ms += one.relight_ms;
      sum.relight_spread_ms = std::max(sum.relight_spread_ms, one.relight_spread_ms);
      sum.over_seed += one.over_seed;
      sum.update_ms += one.update_ms;
      sum.bytes += one.bytes;
    }
    size.bytes_per_s += there.bytes_per_s;
  }
  ++size.observers;
}

void divide(Size& size) {
  const double n = size.observers;
  size.bytes_per_s /= n;
  for (MethodCost& m : size.methods) {
    m.patches /= static_cast<uint32_t>(size.observers);
    m.nodes /= static_cast<size_t>(size.observers);
    for (double* x : {&m.linear, &m.picture, &m.relight_ms, &m.over_seed, &m.update_ms, &m.bytes}) *x /= n;
  }
}

const MethodCost& of(const Size& size, const std::string& name) {
  return *std::find_if(size.methods.begin(), size.methods.end(), [&](const MethodCost& m) { return m.name == name; });
}

// Eyes that see light and have M patches around them, but for a twentieth.
Result<std::vector<Vec3>> eyesOf(const formats::WholeWorld& world, const WorldTruth& truth, uint32_t patches, size_t count) {
  std::vector<Vec3> eyes;
  for (const Vec3 eye : observersOf(truth, static_cast<int>(4 * count), world.info().cell_m)) {
    const auto there = nearestPatches(world, truth, eye, patches);
    if (!there) return there.error();
    const Difference dark = compare(truth, there->pyramid->matrix(), there->source, there->source, there->at);
    if (dark.meanTruth() < 1e-2 * truth.rms || there->activePatches() < patches / 20 * 19) continue;
    eyes.push_back(eye);
    if (eyes.size() == count) break;
  }
  if (eyes.empty())
    return Error{ErrorCode::kUsage, world.path(), "",
                 "no observer has " + std::to_string(patches) + " lit patches around it",
                 "take a larger or brighter scene"};
  return eyes;
}

struct SceneFigures {
  std::string name;
  uint32_t patches = 0;
  std::vector<Size> sizes;  // ascending; the last over all observers, the others at the first
};

Result<SceneFigures> measureScene(const std::string& name, const bake::Scene& scene, const PaperOptions& options,
                                  const PaperProgress& progress) {
  const auto say = [&](const std::string& what) {
    if (progress) progress(name + ": " + what);
  };
  say("bake");
  const auto baked = BakedScene::bake(
      scene, {.cell_m = 1, .rays = options.quick ? 512u : 1024u, .seed = options.seed, .threads = options.threads});
  if (!baked) return baked.error();
  const formats::WholeWorld& world = baked->world();
  say("full solution");
  const auto truth = solveWorldTruth(world, false);
  if (!truth) return truth.error();
  SceneFigures figures{name, formats::wholeNumber(world.levels()[0].nodes), {}};
  const uint32_t largest = options.quick ? 1024 : 4096;
  const auto eyes = eyesOf(world, *truth, largest, kObservers);
  if (!eyes) return eyes.error();
  for (uint32_t m = 256; m <= largest; m *= 2) {
    Size size{.most = m};
    for (size_t eye = 0; eye < eyes->size(); ++eye) {
      say("local matrix of " + numberText(m) + ", observer " + std::to_string(eye + 1) + " of " +
          std::to_string(eyes->size()));
      const auto there = nearestPatches(world, *truth, (*eyes)[eye], m);
      if (!there) return there.error();
      const auto measured = measureMethods(world, *truth, *there,
                                           {.patches = m, .threads = options.threads, .rounds = options.quick ? 5 : 9});
      if (!measured) return measured.error();
      for (const MethodCost& method : measured->methods)
        if (method.name == kExactName) {
          size.worst_picture = std::max(size.worst_picture, method.picture);
          size.worst_linear = std::max(size.worst_linear, method.linear);
        }
      addTo(size, *measured);
    }
    divide(size);
    figures.sizes.push_back(std::move(size));
  }
  return figures;
}

double fullBytes(const SceneFigures& f) {
  return static_cast<double>(f.patches) * static_cast<double>(f.patches) * kTexel;
}

Table figureThree(const std::vector<SceneFigures>& scenes) {
  Table table;
  table.id = "paper-figure-3";
  table.title = "The paper's figure 3: the local matrix against the full one";
  table.note =
      "Difference: mean over the active patches, by area and channel, of |B - full solution|; of a picture's value "
      "(0 to 1, exposed and toned as ffview does), and of linear radiosity over its mean. Beyond the local patches the "
      "dense methods see the mean radiosity there, gather the pyramid. The full matrix's time is its bytes (N x N x 8, "
      "RGBA16F) over the read bandwidth measured in the same run. The paper's figures are a GPU's of 2019, ours this "
      "CPU's: "
      "ratios compare, milliseconds do not.";
  table.columns = {"scene",       "method", "difference, picture", "difference, linear", "relative L2, inner half",
                   "relight, ms", "matrix"};
  table.rows.push_back({"the paper, " + numberText(kPaperPatches) + " patches", "local, M = 4096", "less than 0.05", "",
                        "", kPaperLocal, ""});
  table.rows.push_back({"", "full", "0", "0", "0", kPaperFull, ""});
  for (const SceneFigures& f : scenes) {
    const Size& size = f.sizes.back();
    for (const MethodCost& m : size.methods)
      table.rows.push_back({f.name + ", " + numberText(f.patches) + " patches",
                            m.name +
                                (m.nodes > 0 ? ", " + numberText(static_cast<double>(m.nodes)) + " nodes, " : ", ") +
                                numberText(m.patches) + " patches",
                            shortNumber(m.picture), percentText(m.linear), innerText(m),
                            withError({m.relight_ms, m.relight_spread_ms}), mib(m.bytes)});
    table.rows.push_back({f.name + ", " + numberText(f.patches) + " patches", "full matrix (estimated)", "0", "0", "0",
                          shortNumber(1e3 * fullBytes(f) / size.bytes_per_s), gib(fullBytes(f))});
  }
  return table;
}

Table figureFour(const SceneFigures& f, size_t number) {
  Table table;
  table.id = "paper-figure-4-" + std::to_string(number);
  table.title = "The paper's figure 4: local multi-bounce against common radiosity, " + f.name;
  table.note = "Update: one patch leaves and one enters; multibounce and common radiosity in blocks of " +
               std::to_string(runtime::kMaxBlock) +
               ", gather by tiles, seed one at a time, as its method is. Over seed: of times taken in the same round, "
               "median. Means over the observers.";
  table.columns = {"M",
                   "method",
                   "relight, ms",
                   "over seed",
                   "update a patch, ms",
                   "matrix",
                   "difference, picture",
                   "relative L2, inner half"};
  for (const Size& size : f.sizes)
    for (const MethodCost& m : size.methods)
      table.rows.push_back({numberText(size.most), m.name, withError({m.relight_ms, m.relight_spread_ms}),
                            shortNumber(m.over_seed), shortNumber(m.update_ms), mib(m.bytes), shortNumber(m.picture),
                            innerText(m)});
  return table;
}

template <class Value>
Chart overSizes(const SceneFigures& f, size_t number, const std::string& id, const std::string& title,
                const std::string& y_label, const std::string& note, const Value& value) {
  Chart chart;
  chart.id = id + "-" + std::to_string(number);
  chart.title = title + ": " + f.name;
  chart.x_label = "patches of the local matrix, M";
  chart.y_label = y_label;
  chart.note = note;
  chart.log_x = chart.log_y = true;
  for (const MethodCost& method : f.sizes.front().methods) {
    Series series;
    series.name = method.name;
    for (const Size& size : f.sizes) {
      const Figure y = value(of(size, method.name));
      series.points.push_back({.x = static_cast<double>(size.most),
                               .y = y.value,
                               .y_error = y.error,
                               .hover = method.name + ", M = " + numberText(size.most) + ": " + withError(y)});
    }
    chart.series.push_back(std::move(series));
  }
  return chart;
}

std::string leadOf(const std::vector<SceneFigures>& scenes) {
  std::string lead;
  for (const SceneFigures& f : scenes) {
    const Size& size = f.sizes.back();
    const MethodCost &exact = of(size, kExactName), &seed = of(size, kSeedName), &common = of(size, kCommonName),
                     &gather = of(size, kGatherName);
    const double full_ms = 1e3 * fullBytes(f) / size.bytes_per_s;
    lead += (lead.empty() ? "" : " ") + std::string("On ") + f.name + " (" + numberText(f.patches) +
            " patches) the local multi-bounce matrix with M = " + numberText(size.most) +
            " differs from the full solution by " + shortNumber(exact.picture) +
            " of a picture's range on average (worst observer " + shortNumber(size.worst_picture) +
            "; the paper: less than " + numberText(kPaperDifference) + "), gather on the pyramid by " +
            shortNumber(gather.picture) + ". The paper's update as printed relights in " +
            shortNumber(seed.relight_ms) + " ms (" + mib(seed.bytes) + "), " + shortNumber(full_ms / seed.relight_ms) +
            " times faster than the full matrix would be (" + shortNumber(full_ms) + " ms, " + gib(fullBytes(f)) +
            "; the paper: 150 times); common radiosity takes " + shortNumber(common.over_seed) +
            " times as long as the former, a step of gather " + shortNumber(gather.over_seed) + " times (" +
            shortNumber(gather.relight_ms) + " ms).";
  }
  return lead;
}

}  // namespace

Result<Report> measurePaper(const PaperOptions& options, const PaperProgress& progress) {
  std::vector<SceneFigures> scenes;
  if (!options.scene_path.empty()) {
    const auto scene = bake::importGltf(options.scene_path);
    if (!scene) return scene.error();
    auto figures = measureScene(std::filesystem::path(options.scene_path).stem().string(), *scene, options, progress);
    if (!figures) return figures.error();
    scenes.push_back(std::move(*figures));
  }
  const auto town =
      tools::makeTown({.patches = options.quick ? 8000 : static_cast<uint64_t>(kPaperPatches), .seed = options.seed});
  if (!town) return town.error();
  auto figures = measureScene("town", sceneOf(tools::townModel(*town, false)), options, progress);
  if (!figures) return figures.error();
  scenes.push_back(std::move(*figures));

  Report report;
  report.title = "The seed paper's figures, measured again";
  report.lead = leadOf(scenes);
  for (const SceneFigures& f : scenes)
    report.facts.push_back({"scene", f.name + ", " + numberText(f.patches) + " patches of 1 m, sun and sky; reads " +
                                         shortNumber(f.sizes.back().bytes_per_s / 1e9) +
                                         " GB/s; observers: " + std::to_string(f.sizes.back().observers)});
  report.facts.push_back({"seed", numberText(static_cast<double>(options.seed))});
  report.tables.push_back(figureThree(scenes));
  for (size_t i = 0; i < scenes.size(); ++i) {
    const SceneFigures& f = scenes[i];
    report.charts.push_back(
        overSizes(f, i + 1, "paper-relight", "Relighting (figure 4)", "ms a relight",
                  "seed and multibounce: one product with all bounces. Common radiosity: three products. Gather: one "
                  "step on a cut with M patches and the pyramid beyond. Median of interleaved rounds, half the "
                  "distance of the quartiles.",
                  [](const MethodCost& m) {
                    return Figure{m.relight_ms, m.relight_spread_ms};
                  }));
    report.charts.push_back(overSizes(
        f, i + 1, "paper-update", "Updating", "ms a patch that leaves and one that enters",
        "Blocks of 64 (multibounce, common radiosity), tiles (gather), one at a time (seed).", [](const MethodCost& m) {
          return Figure{m.update_ms, 0};
        }));
    report.charts.push_back(overSizes(f, i + 1, "paper-difference", "Difference to the full solution (figure 3)",
                                      "mean difference of a picture's value",
                                      "Over all active patches; 1 is white. The paper: less than 0.05 at M = 4096.",
                                      [](const MethodCost& m) {
                                        return Figure{m.picture, 0};
                                      }));
    report.charts.back().y_marks = {{kPaperDifference, "the paper"}};
    report.tables.push_back(figureFour(f, i + 1));
  }
  return report;
}

}  // namespace ff::chart
