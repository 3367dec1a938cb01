// ff_bench_update: what it costs to let nodes enter and leave the dense matrices, and what is left of their accuracy
// after walks of up to 100,000 swaps (one node leaves, one enters). Truth is the direct solution in double precision on
// the set that is in at the moment. Synthetic form factors (tools/chart/walks.h). Prints JSON lines.
#include <CLI/CLI.hpp>

#include "runtime/dense/bounce_monitor.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/dense_solver.h"
#include "tests/bench/tile_apply.h"
#include "tests/bench/truth.h"
#include "tests/bench/vulkan_update.h"
#include "tools/chart/walks.h"

namespace {

using namespace ff;
using namespace ff::bench;
using namespace ff::runtime;
using namespace ff::walks;

std::string number(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", x);
  return text;
}

using Maker = Result<std::unique_ptr<BounceMatrix>> (*)(const MultibounceSettings&);

// Enters in blocks of kMaxBlock. False where one is refused.
bool fill(BounceMatrix& matrix, Placement& at, std::span<const uint32_t> patches) {
  for (size_t i = 0; i < patches.size(); i += kMaxBlock)
    if (!matrix.insert(at.enter(patches.subspan(i, std::min<size_t>(kMaxBlock, patches.size() - i))))) return false;
  return true;
}

struct WalkCase {
  std::string name;
  SceneSettings scene;
  WalkKind kind;
  uint32_t places;
  uint32_t block;
  uint32_t swaps;
};

std::string describe(const WalkCase& c) {
  return c.name + ", M = " + std::to_string(c.places) + ", " + std::to_string(c.swaps) + " swaps in blocks of " +
         std::to_string(c.block);
}

// E += r + G C r with r = F (M + C E) - E: one sparse and one dense product, what the dense solver does every frame.
void correct(BounceMatrix& matrix, const Placement& at, std::span<const Vec4> source, std::vector<Vec4>& e) {
  const SceneRows& set = at.set();
  std::vector<Vec4> reflected(e.size()), correction(e.size());
  std::vector<Rgb> residual(e.size());
  for (uint32_t i = 0; i < e.size(); ++i) {
    const uint32_t p = at.patch(i);
    if (p == Placement::kNone) continue;
    Rgb sum{-static_cast<double>(e[i].x), -static_cast<double>(e[i].y), -static_cast<double>(e[i].z)};
    for (uint32_t k = set.row_start[p]; k < set.row_start[p + 1]; ++k) {
      const uint32_t j = at.place(set.columns[k]);
      if (j == Placement::kNone) continue;
      const Vec4 rho = set.albedo[set.columns[k]];
      const auto f = static_cast<double>(set.row_values[k]);
      sum[0] += f * static_cast<double>(source[j].x + rho.x * e[j].x);
      sum[1] += f * static_cast<double>(source[j].y + rho.y * e[j].y);
      sum[2] += f * static_cast<double>(source[j].z + rho.z * e[j].z);
    }
    residual[i] = sum;
    const Vec4 rho = set.albedo[p];
    reflected[i] = {rho.x * static_cast<float>(sum[0]), rho.y * static_cast<float>(sum[1]),
                    rho.z * static_cast<float>(sum[2]), 0};
  }
  orExit(matrix.relight(reflected, correction));
  for (size_t i = 0; i < e.size(); ++i) {
    e[i].x += static_cast<float>(residual[i][0]) + correction[i].x;
    e[i].y += static_cast<float>(residual[i][1]) + correction[i].y;
    e[i].z += static_cast<float>(residual[i][2]) + correction[i].z;
  }
}

// ||F (M + C E) - E|| / ||F M||: what a solver can see of its own error.
double residual(BounceMatrix& matrix, const Placement& at, std::span<const Vec4> source, std::vector<Vec4>& e) {
  orExit(matrix.relight(source, e));
  const SceneRows& set = at.set();
  double left = 0, norm = 0;
  for (uint32_t i = 0; i < e.size(); ++i) {
    const uint32_t p = at.patch(i);
    if (p == Placement::kNone) continue;
    double once = 0, all = 0;
    for (uint32_t k = set.row_start[p]; k < set.row_start[p + 1]; ++k) {
      const uint32_t j = at.place(set.columns[k]);
      if (j == Placement::kNone) continue;
      const auto f = static_cast<double>(set.row_values[k]);
      once += f * static_cast<double>(source[j].y);
      all += f * static_cast<double>(source[j].y + set.albedo[set.columns[k]].y * e[j].y);
    }
    left += (all - static_cast<double>(e[i].y)) * (all - static_cast<double>(e[i].y));
    norm += once * once;
  }
  return norm > 0 ? std::sqrt(left / norm) : 0;
}

struct Drift {
  double fresh = 0;       // error of the matrix as first built
  double worst = 0;       // over the checkpoints
  double corrected = 0;   // worst after four corrections
  uint32_t refused = 0;   // blocks; the matrix was then built anew
  uint32_t rebuilt = 0;   // by the residual
  bool taken = true;      // false: it cannot be built, the matrix says so
  uint32_t broke_at = 0;  // swaps after which the error was first above `limit`; 0: never
};

Drift drift(const WalkCase& c, Maker make, Storage storage, double limit, bool doubling) {
  const SceneRows scene = makeScene(c.scene);
  const auto matrix = orExit(make({.places = c.places, .storage = storage}));
  auto at = std::make_unique<Placement>(scene, c.places);
  Walk walk(c.kind, scene.patches(), c.places, c.block, 1);
  Drift d;
  d.taken = fill(*matrix, *at, walk.present());
  if (!d.taken) return d;
  const std::vector<Vec4> source = randomLight(c.places, 7);
  const auto check = [&] {
    const std::vector<Rgb> exact = exactIrradiance(*at, source);
    std::vector<Vec4> e(c.places);
    orExit(matrix->relight(source, e));
    const double error = relativeError(e, exact);
    for (int i = 0; i < 4; ++i) correct(*matrix, *at, source, e);
    d.corrected = std::max(d.corrected, relativeError(e, exact));
    return std::isfinite(error) ? error : std::numeric_limits<double>::infinity();
  };
  d.fresh = check();
  std::vector<Vec4> probe(c.places);
  double fresh = residual(*matrix, *at, source, probe);
  const auto rebuild = [&] {
    orExit(matrix->clear());
    at = std::make_unique<Placement>(scene, c.places);
    const bool filled = fill(*matrix, *at, walk.present());
    fresh = residual(*matrix, *at, source, probe);
    return filled;
  };
  uint32_t next = doubling ? 50 : c.swaps / 8;
  for (uint32_t done = 0; done < c.swaps;) {
    const Walk::Step step = walk.next();
    orExit(matrix->remove(at->leave(step.leaving)));
    if (!step.entering.empty() && !matrix->insert(at->enter(step.entering))) {
      ++d.refused;
      d.taken = rebuild();
      if (!d.taken) return d;
    }
    done += static_cast<uint32_t>(step.entering.size());
    // As the dense solver does it; the seed has no such thing.
    const double most = std::max(defaultProbeLimit(matrix->name()), kOfFresh * fresh);
    if (!doubling && residual(*matrix, *at, source, probe) > most) {
      ++d.rebuilt;
      d.taken = rebuild();
      if (!d.taken) return d;
    }
    if (done < next && done < c.swaps) continue;
    next = doubling ? 2 * next : next + c.swaps / 8;
    const double error = check();
    d.worst = std::max(d.worst, error);
    if (error > limit && d.broke_at == 0) d.broke_at = done;
    if (doubling && d.broke_at > 0 && error > 1) break;
  }
  return d;
}

// A matrix of M places of which the last is taken, so that every pass goes over all of it.
std::unique_ptr<BounceMatrix> wide(Maker make, const MultibounceSettings& settings) {
  auto matrix = orExit(make(settings));
  const std::vector<uint32_t> place{settings.places - 1}, start{0, 0};
  const std::vector<Vec4> albedo(1);
  orExit(matrix->insert({place, albedo, start, {}, {}, start, {}, {}}));
  return matrix;
}

void speed(bool quick) {
  const uint32_t places = 4096, k = kMaxBlock;
  const SceneRows scene = makeScene({.patches = 2 * places});
  std::vector<uint32_t> there(places - k - 1);
  for (uint32_t i = 0; i < there.size(); ++i) there[i] = i;
  struct Candidate {
    std::string name;
    std::unique_ptr<BounceMatrix> matrix;
    uint32_t block;
    Placement at;
    std::vector<double> ms = {};  // a round each: a node, leaving and entering
  };
  std::vector<Candidate> all;
  all.push_back({"seed", wide(makeCpuSeed, {.places = places}), 1, Placement(scene, places - 1)});
  for (const auto& [name, storage, luminance] :
       {std::tuple{"fp32", Storage::kFloat32, false}, std::tuple{"fp16", Storage::kFloat16, false},
        std::tuple{"fp32 luminance", Storage::kFloat32, true}})
    all.push_back({name, wide(makeCpuMultibounce, {.places = places, .storage = storage, .luminance = luminance}), k,
                   Placement(scene, places - 1)});
  // The seed's passes take the same time whatever the matrix holds; filling it one by one would take minutes.
  for (size_t c = 1; c < all.size(); ++c)
    if (!fill(*all[c].matrix, all[c].at, there)) std::exit(1);
  for (int repeat = 0; repeat < (quick ? 9 : 15); ++repeat)
    for (Candidate& c : all) {  // a pass over the dense matrix takes along one block that left and one that entered
      std::vector<uint32_t> some(c.block);
      for (uint32_t i = 0; i < c.block; ++i) some[i] = places + static_cast<uint32_t>(repeat) * k + i;
      std::vector<double> turns;
      for (int turn = 0; turn < (c.block == 1 ? 4 : 1); ++turn) {
        const EnteringBlock block = c.at.enter(some);
        auto start = Clock::now();
        orExit(c.matrix->insert(block));
        double ms = msSince(start);
        const auto leaving = c.at.leave(some);
        start = Clock::now();
        orExit(c.matrix->remove(leaving));
        ms += msSince(start);
        turns.push_back(ms / c.block);
      }
      c.ms.push_back(median(turns));
    }
  const auto middle = [](std::vector<double> values) { return median(values); };
  for (size_t c = 1; c < all.size(); ++c) {
    std::vector<double> ratios;  // within a round: a shared machine changes its pace in the midst of a run
    for (size_t round = 0; round < all[c].ms.size(); ++round) ratios.push_back(all[0].ms[round] / all[c].ms[round]);
    const auto [least, most] = std::minmax_element(ratios.begin(), ratios.end());
    print("update.block_speedup_over_single", middle(ratios), "ratio", 10,
          "multibounce cpu " + all[c].name + ", blocks of " + std::to_string(k) + " enter and leave, M = " +
              std::to_string(places) + ": " + number(middle(all[c].ms)) + " ms a node against the seed's " +
              number(middle(all[0].ms)) + " ms, one at a time; median of the ratios of " +
              std::to_string(ratios.size()) + " rounds, " + number(*least) + " to " + number(*most) +
              "; the limit is the target");
  }
}

constexpr const char* kSpeed = "speed";

// only: walks whose description (name, M) contains it; empty: all of them, and the cost of an update; kSpeed: that alone.
void run(bool quick, uint32_t max_swaps, const std::string& only) {
  if (only.empty() || only == kSpeed) speed(quick);
  if (only == kSpeed) return;
  const uint32_t swaps = std::min(quick ? 10000u : 100000u, max_swaps);
  const auto box = [](float albedo, uint32_t n) {
    return SceneSettings{.kind = SceneKind::kClosedBox, .patches = n, .entries_per_row = 60, .albedo = albedo};
  };
  std::vector<WalkCase> walks;
  const std::pair<WalkKind, const char*> kinds[] = {{WalkKind::kStraight, "straight line"},
                                                    {WalkKind::kOscillation, "oscillation over a tile border"},
                                                    {WalkKind::kTeleports, "random teleports"}};
  for (const auto& [kind, name] : kinds) {
    walks.push_back({name, {.patches = 1024}, kind, 256, 32, swaps});
    walks.push_back({name, {.patches = 4096}, kind, 1024, 64, quick ? 1024 : swaps});
    // Nodes that stay gather every update's rounding. The other walks take minutes to half an hour: when asked for.
    const bool longest = kind == WalkKind::kOscillation || !only.empty();
    if (!quick) walks.push_back({name, {.patches = 16384}, kind, 4096, 64, longest ? swaps : std::min(swaps, 8192u)});
  }
  walks.push_back({"tiny enclosures, albedo 0.98",
                   {.kind = SceneKind::kEnclosures, .patches = 512, .entries_per_row = 30, .albedo = 0.98f},
                   WalkKind::kStraight,
                   256,
                   7,
                   swaps});
  for (const float albedo : {0.5f, 0.9f, 0.98f, 0.999f}) {
    const bool hard = albedo > 0.99f;
    walks.push_back({"closed box, albedo " + number(static_cast<double>(albedo)), box(albedo, 256), WalkKind::kRandom,
                     256, 32, quick && hard ? 2000 : swaps});
  }
  std::erase_if(walks, [&](const WalkCase& c) { return describe(c).find(only) == std::string::npos; });
  struct Kind {
    const char* name;
    Storage storage;
    double limit;
    double worst = 0, worst_corrected = 0;
    std::string at = "", not_taken = "";
  };
  Kind storages[] = {{"fp32", Storage::kFloat32, 1e-5}, {"fp16", Storage::kFloat16, 5e-3}};
  for (const WalkCase& c : walks) {
    for (Kind& kind : storages) {
      const Drift d = drift(c, makeCpuMultibounce, kind.storage, kind.limit, false);
      if (!d.taken) {
        kind.not_taken += "; " + c.name + " is refused with a message";
        print("update.walk_" + std::string(kind.name), std::numeric_limits<double>::quiet_NaN(), "relative L2",
              kind.limit, describe(c) + "; refused with a message: more gain than the storage can carry");
        continue;
      }
      print("update.walk_" + std::string(kind.name), d.worst, "relative L2", kind.limit,
            describe(c) + "; as first built " + number(d.fresh) + "; after four corrections " + number(d.corrected) +
                (d.refused > 0 ? "; " + std::to_string(d.refused) + " blocks refused, the matrix built anew" : "") +
                (d.rebuilt > 0 ? "; built anew " + std::to_string(d.rebuilt) + " times by the residual probe" : ""));
      if (d.corrected > kind.worst_corrected) kind.worst_corrected = d.corrected, kind.at = c.name;
      kind.worst = std::max(kind.worst, d.worst);
    }
    if (c.places > (quick ? 256u : 1024u)) continue;
    WalkCase one = c;
    one.block = 1;
    one.swaps = std::min(c.swaps, quick ? 2000u : c.places == 256 ? 100000u : 10000u);
    const Drift d = drift(one, makeCpuSeed, Storage::kFloat16, 0.05, true);
    print("update.walk_seed", d.worst, "relative L2", 5e-3,
          describe(one) + "; as first built " + number(d.fresh) + "; " +
              (d.broke_at > 0 ? "above 5 % after " + std::to_string(d.broke_at) + " swaps" : "never above 5 %") +
              (std::isfinite(d.worst) ? "" : "; not finite in the end"));
  }
  for (const Kind& kind : storages)
    print("update.drift_" + std::string(kind.name), kind.worst_corrected, "relative L2", kind.limit,
          "worst over all walks of what the solver shows (four corrections of the light), at: " + kind.at +
              "; of the bare matrix " + number(kind.worst) + "; up to " + std::to_string(swaps) + " swaps" +
              kind.not_taken);
}

}  // namespace

int main(int argc, char** argv) {
  bool quick = false;
  std::string world;
  CLI::App app{"Cost and drift of nodes that enter and leave the dense matrices. One JSON object a line."};
  uint32_t max_swaps = 100000;
  app.add_flag("--quick", quick, "fewer swaps, no walks of M = 4096");
  app.add_option("--swaps", max_swaps, "in a walk, at most")->check(CLI::Range(1024, 100000))->capture_default_str();
  app.add_option("--world", world, "a baked town, for the cost of a tile; without it one is baked");
  std::string only;
  app.add_option("--only", only,
                 "walks whose description contains this, such as 'oscillation' or 'M = 4096', without timing; 'speed': no "
                 "walks, the cost of an update alone");
  CLI11_PARSE(app, argc, argv);
  if (only.empty()) {
    ff::bench::printTileApply(world, quick);
    ff::bench::printVulkanUpdates(world, quick);
  }
  run(quick, max_swaps, only);
  return 0;
}
