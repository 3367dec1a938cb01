// ff_bench_relight: from new light to bounced light, how fast and how exact. On a town, at the default cut: one step of
// `gather` beside one relight of `seed` (the paper's method: the nearest patches, at most 4096, all else one constant),
// of plain local radiosity and of `multibounce` on the same patches; their errors against the double-precision solve of
// the whole world; and what the machine could do: its read bandwidth, Eigen's sparse product. Prints JSON lines.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <Eigen/Sparse>
#include <algorithm>

#include "formats/read/whole_world.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/vk_multibounce.h"
#include "runtime/dense/vk_seed.h"
#include "runtime/gather/vk_gather.h"
#include "runtime/solver/worker_pool.h"
#include "tests/bench/truth.h"
#include "tools/chart/neighbourhood.h"
#include "tools/chart/read_bandwidth.h"

namespace {

using namespace ff;
using namespace ff::bench;
using chart::gatherBytes;
using chart::Neighbourhood;
using chart::ReadBandwidth;
using namespace ff::runtime;
using namespace ff::walks;

struct Options {
  std::string world, backend = "both";
  bool quick = false;
  int observers = 5;
  uint32_t patches = 4096;
  int threads = 0;
};

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

template <class Step>
double medianMs(int repeats, const Step& step) {
  std::vector<double> ms;
  for (int i = 0; i < repeats; ++i) {
    const auto began = Clock::now();
    step();
    ms.push_back(msSince(began));
  }
  return median(ms);
}

std::unique_ptr<Solver> solverAt(const Neighbourhood& place, std::unique_ptr<Solver> solver) {
  orExit(chart::lightUp(place, *solver));
  return solver;
}

// A node at the highest place makes a matrix as large as a full one, for what time alone is asked.
void occupyLast(BounceMatrix& matrix) {
  const uint32_t place[] = {matrix.capacity() - 1}, none[] = {0, 0};
  const Vec4 albedo[] = {{0.5f, 0.5f, 0.5f, 0}};
  orExit(matrix.insert({place, albedo, none, {}, {}, none, {}, {}}));
}

double relightMs(BounceMatrix& matrix, int repeats) {
  const std::vector<Vec4> source = randomLight(matrix.capacity(), 1);
  std::vector<Vec4> irradiance(matrix.capacity());
  return medianMs(repeats, [&] { orExit(matrix.relight(source, irradiance)); });
}

struct EigenMs {
  double fastest = 0, usual = 0;  // the best of its ways; a matrix of three columns as it comes (column-major)
};

// Eigen's ways to multiply this matrix with three channels, one thread.
EigenMs eigenMs(const LocalMatrix& m, int repeats) {
  std::vector<Eigen::Triplet<float>> entries;
  for (const uint32_t slot : m.leaves)
    for (const uint32_t entry : m.row(slot))
      entries.emplace_back(slot, slotOfEntry(entry), static_cast<float>(countOfEntry(entry)) * m.row_scale[slot]);
  Eigen::SparseMatrix<float, Eigen::RowMajor> f(m.slots(), m.slots());
  f.setFromTriplets(entries.begin(), entries.end());
  const auto time = [&]<class Dense>(Dense b) {
    Dense e = b;
    return medianMs(repeats, [&] { e.noalias() = f * b; });
  };
  using Rows3 = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  using Rows4 = Eigen::Matrix<float, Eigen::Dynamic, 4, Eigen::RowMajor>;
  const auto n = static_cast<Eigen::Index>(m.slots());
  EigenMs ms;
  ms.usual = time(Eigen::MatrixX3f(Eigen::MatrixX3f::Ones(n, 3)));
  ms.fastest = std::min({ms.usual, time(Rows3(Rows3::Ones(n, 3))), time(Rows4(Rows4::Ones(n, 4))),
                         3 * time(Eigen::VectorXf(Eigen::VectorXf::Ones(n)))});
  return ms;
}

std::string percent(double x) { return std::to_string(100 * x) + " %"; }

void runCpu(const Options& options, const formats::WholeWorld& world, const Truth& truth, const std::vector<Neighbourhood>& places) {
  WorkerPool pool(options.threads);
  const std::string machine = std::to_string(pool.threads()) + " threads";
  ReadBandwidth bandwidth(pool);
  std::vector<double> passes;
  for (int i = 0; i < 7; ++i) passes.push_back(bandwidth.pass());
  const double read_bytes_per_s = median(passes);
  const Neighbourhood& first = places.front();
  const chart::LocalPatches local = orExit(chart::localPatches(world, truth, first));
  const uint32_t patches = local.patches();
  const MultibounceSettings settings{.places = options.patches, .threads = options.threads};
  const int repeats = options.quick ? 5 : 15;

  // Accuracy, and the matrices whose products are then timed.
  std::vector<std::unique_ptr<BounceMatrix>> dense;
  for (auto* make : {&makeCpuSeed, &makeCpuMultibounce}) dense.push_back(orExit((*make)(settings)));
  MultibounceSettings half = settings;
  half.storage = Storage::kFloat16;
  dense.push_back(orExit(makeCpuMultibounce(half)));
  dense.push_back(orExit(makeCpuPlainLocal(settings)));
  const char* const names[] = {"seed", "multibounce", "multibounce_fp16", "plain"};
  std::vector<double> errors, ms(dense.size());
  for (size_t d = 0; d < dense.size(); ++d) {
    Placement placement(local.set, options.patches);
    orExit(chart::fillMatrix(*dense[d], placement, patches, d == 0 ? 1 : kMaxBlock));
    const std::vector<Vec4> radiosity = orExit(chart::relitRadiosity(local, placement, *dense[d]));
    errors.push_back(compare(truth, local.matrix, radiosity, local.slot_source, first.at).relative());
  }

  std::vector<double> gather_ms, gather_errors, leaves, entries;
  // Bandwidth is measured beside what is compared with it, so that whatever else the machine does hits both.
  const auto share = [&](double bytes, const auto& step, int steps) {
    std::vector<double> shares;
    for (int round = 0; round < repeats; ++round) {
      const double read = bandwidth.pass();
      step();  // a pass has emptied the caches
      shares.push_back(bytes / (medianMs(steps, step) * 1e-3) / read);
    }
    return median(shares);
  };
  std::vector<double> fractions;
  for (const Neighbourhood& place : places) {
    const auto solver = solverAt(place, makeCpuGather(options.threads));
    orExit(solver->iterate(200));
    std::vector<Vec4> radiosity(place.source.size());
    orExit(solver->radiosity(radiosity));
    gather_errors.push_back(compare(truth, place.pyramid->matrix(), radiosity, place.source, place.at).relative());
    gather_ms.push_back(medianMs(20 * repeats, [&] { orExit(solver->iterate(1)); }));
    leaves.push_back(static_cast<double>(place.pyramid->matrix().leaves.size()));
    entries.push_back(static_cast<double>(place.pyramid->matrix().used_entries));
    fractions.push_back(share(
        gatherBytes(place.pyramid->matrix()), [&] { orExit(solver->iterate(1)); }, 31));
  }
  for (size_t d = 0; d < dense.size(); ++d) ms[d] = relightMs(*dense[d], repeats);

  // The speed-up is taken round by round, so that whatever else the machine does hits both.
  const auto alternating = solverAt(first, makeCpuGather(options.threads));
  std::vector<double> ratios;
  const std::vector<Vec4> light = randomLight(options.patches, 2);
  std::vector<Vec4> irradiance(options.patches);
  for (int round = 0; round < repeats; ++round) {
    const double seed = medianMs(1, [&] { orExit(dense[0]->relight(light, irradiance)); });
    ratios.push_back(seed / medianMs(31, [&] { orExit(alternating->iterate(1)); }));
  }
  const double first_error = gather_errors.front(),
               worst_error = *std::max_element(gather_errors.begin(), gather_errors.end());
  const std::string cut = std::to_string(static_cast<uint64_t>(median(leaves))) + " active nodes, " +
                          std::to_string(static_cast<uint64_t>(median(entries))) + " entries (medians of " +
                          std::to_string(places.size()) + " observers), " + machine;
  const std::string matrix = std::to_string(patches) + " patches of at most " + std::to_string(options.patches) + ", " +
                             machine + ", machine reads " + std::to_string(read_bytes_per_s / 1e9) + " GB/s";
  print("relight.gather_ms", median(gather_ms), "ms", kNone, "one step of gather; " + cut, "cpu");
  for (size_t d = 0; d < dense.size(); ++d)
    print(std::string("relight.") + names[d] + "_ms", ms[d], "ms", kNone, matrix, "cpu");
  print("relight.gather_speedup_over_seed", median(ratios), "ratio", 12,
        "median of " + std::to_string(repeats) + " rounds at one observer, seed over gather within a round; " +
            std::to_string(first.pyramid->matrix().leaves.size()) + " active nodes, " +
            std::to_string(first.pyramid->matrix().used_entries) + " entries; target at least 12",
        "cpu");
  print(
      "relight.gather_error", first_error, "relative L2", errors[0],
      "reflected radiosity in the inner half at the same observer, converged; limit: seed's; worst of all observers " +
          percent(worst_error),
      "cpu");
  for (size_t d = 0; d < dense.size(); ++d)
    print(std::string("relight.") + names[d] + "_error", errors[d], "relative L2", kNone,
          "same patches, all else one constant at its best value (mean radiosity outside)", "cpu");
  print("relight.gather_bandwidth_fraction", median(fractions), "ratio", 0.7,
        "bytes of the local matrix and of the rows' data over time, of " + std::to_string(read_bytes_per_s / 1e9) +
            " GB/s; above 1: it fits in cache; " + cut,
        "cpu");
  const auto one = solverAt(first, makeCpuGather(1));
  std::vector<double> over_usual, over_fastest;
  for (int round = 0; round < 9; ++round) {
    const double ours = medianMs(25, [&] { orExit(one->iterate(1)); });
    const EigenMs eigen = eigenMs(first.pyramid->matrix(), 7);
    over_usual.push_back(eigen.usual / ours);
    over_fastest.push_back(eigen.fastest / ours);
  }
  print("relight.gather_over_eigen", median(over_usual), "ratio", 3,
        "Eigen's SparseMatrix times MatrixX3f over one step of gather, one thread each; target at least 3", "cpu");
  print("relight.gather_over_eigen_fastest", median(over_fastest), "ratio", 3,
        "likewise, the fastest of Eigen's ways (three or four columns by rows, by columns, three vectors)", "cpu");
  const auto used = static_cast<double>(patches);
  const auto denseShare = [&](size_t d, double bytes_an_element) {
    return share(
        3 * bytes_an_element * used * used, [&] { orExit(dense[d]->relight(light, irradiance)); }, 3);
  };
  print("relight.multibounce_bandwidth_fraction", denseShare(1, 4), "ratio", 0.85,
        "fp32, bytes of the part in use over time, read bandwidth measured in each round; " + matrix, "cpu");
  print("relight.multibounce_fp16_bandwidth_fraction", denseShare(2, 2), "ratio", 0.85, "fp16; " + matrix, "cpu");
}

void runVulkan(const Options& options, const formats::WholeWorld& world, const Neighbourhood& place) {
  auto context = openVulkan();
  if (!context) {
    std::cerr << "ff_bench_relight: Vulkan is left out: " << context.error().line() << "\n";
    return;
  }
  const std::string device = deviceName(**context);
  const int repeats = options.quick ? 3 : 9;
  const auto solver = solverAt(place, orExit(makeVulkanGather(*context, gatherRoomFor(world, slotsFor(stream::StreamSettings().max_nodes)))));
  std::vector<double> gather;
  for (int i = 0; i < repeats; ++i) {
    orExit(solver->iterate(1));
    gather.push_back(solver->lastMs());
  }
  const MultibounceSettings settings{.places = options.patches};
  const auto seed = orExit(makeVulkanSeed(*context, settings)),
             multibounce = orExit(makeVulkanMultibounce(*context, settings));
  std::vector<double> seed_ms, multibounce_ms;
  std::vector<Vec4> irradiance(options.patches);
  const std::vector<Vec4> light = randomLight(options.patches, 3);
  for (auto [matrix, ms] : {std::pair{seed.get(), &seed_ms}, {multibounce.get(), &multibounce_ms}}) {
    occupyLast(*matrix);
    for (int i = 0; i < repeats; ++i) {
      orExit(matrix->relight(light, irradiance));
      ms->push_back(matrix->stats().last_relight_ms);
    }
  }
  const std::string note = device + ", device timestamps, median of " + std::to_string(repeats);
  const double gather_ms = median(gather), seed_median = median(seed_ms), multibounce_median = median(multibounce_ms);
  print("relight.gather_ms", gather_ms, "ms", kNone,
        std::to_string(place.pyramid->matrix().used_entries) + " entries; " + note, "vulkan");
  print("relight.seed_ms", seed_median, "ms", kNone, "M = " + std::to_string(options.patches) + "; " + note, "vulkan");
  print("relight.multibounce_ms", multibounce_median, "ms", kNone,
        "fp32, M = " + std::to_string(options.patches) + "; " + note, "vulkan");
  const double copies = orExit(deviceCopyBandwidth(**context));  // bytes read and written a second
  print("relight.device_copy_bandwidth", copies, "B/s", kNone, "read and written; " + note, "vulkan");
  const auto fraction = [&](const std::string& metric, double bytes, double ms) {
    print(metric, bytes / (ms * 1e-3) / copies, "ratio", 1, "of the device's copy bandwidth; " + note, "vulkan");
  };
  fraction("relight.gather_bandwidth_fraction", gatherBytes(place.pyramid->matrix()), gather_ms);
  fraction("relight.multibounce_bandwidth_fraction", static_cast<double>(multibounce->bytes()), multibounce_median);
  fraction("relight.seed_bandwidth_fraction", static_cast<double>(seed->bytes()), seed_median);
  print("relight.gather_speedup_over_seed", seed_median / gather_ms, "ratio", 20,
        "target at least 20 on a real GPU; " + note, "vulkan");
}

void run(const Options& options) {
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_relight_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const formats::WholeWorld world =
      orExit(formats::WholeWorld::open(options.world.empty() ? bakeTown(folder, options.quick) : options.world));
  const Truth truth = solveTruth(world, false);
  std::vector<Neighbourhood> places;
  for (const Vec3 observer : observersOf(truth, 4 * options.observers, world.info().cell_m)) {
    Neighbourhood place = orExit(chart::neighbourhoodAt(
        world, truth, observer, {.hysteresis = 1.0f, .max_level0_nodes = options.patches}));
    const auto dark = compare(truth, place.pyramid->matrix(), place.source, place.source, place.at);
    if (dark.meanTruth() < 1e-2 * truth.rms) continue;  // errors there are of nothing
    places.push_back(std::move(place));
    if (places.size() == static_cast<size_t>(options.observers)) break;
  }
  // The dense methods are compared where they are as large as they may be, and the cut is of middling size there.
  std::stable_sort(places.begin(), places.end(),
                   [](const Neighbourhood& a, const Neighbourhood& b) { return a.leaves() < b.leaves(); });
  uint32_t largest = 0;
  for (const Neighbourhood& place : places) largest = std::max(largest, place.activePatches());
  const auto full = std::stable_partition(places.begin(), places.end(), [&](const Neighbourhood& place) {
    return place.activePatches() >= largest / 20 * 19;
  });
  if (full != places.begin()) std::iter_swap(places.begin(), places.begin() + (full - places.begin()) / 2);
  std::filesystem::remove_all(folder);
  if (places.empty()) {
    std::cerr << "ff_bench_relight: no observer sees light; bake a world that the sun reaches\n";
    std::exit(1);
  }
  if (options.backend != "vulkan") runCpu(options, world, truth, places);
  if (options.backend != "cpu") runVulkan(options, world, places.front());
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{"From new light to bounced light: time and error of every solver. One JSON object a line."};
  app.add_option("--world", options.world, "a baked world with drawing geometry; without it a town is baked");
  app.add_flag("--quick", options.quick, "a smaller town and matrix");
  app.add_option("--observers", options.observers)->check(CLI::Range(1, 100))->capture_default_str();
  app.add_option("--patches", options.patches, "of the dense matrices: 4096")->check(CLI::Range(64, 8192));
  app.add_option("--backend", options.backend, "cpu, vulkan or both")->check(CLI::IsMember({"cpu", "vulkan", "both"}));
  app.add_option("--threads", options.threads, "0: all cores")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  if (options.quick && app.get_option("--patches")->empty()) options.patches = 1024;
  run(options);
  return 0;
}
