#include "tools/view/solver.h"

#include <utility>

#include "runtime/choose_solver.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/dense_solver.h"
#include "runtime/dense/vk_multibounce.h"
#include "runtime/gather/vk_gather.h"

namespace ff::view {
namespace {

using runtime::SolverChoice;
using runtime::SolverKind;

Result<SolverChoice> chosen(const formats::World& world, const stream::Streamer& streamer, const std::string& kind) {
  SolverChoice choice;
  choice.kind = kind == "multibounce" ? SolverKind::kMultibounce : SolverKind::kGather;
  if (kind != "auto") return choice;
  auto recommended = runtime::readRecommendation(world.path());
  if (!recommended) return recommended.error();
  if (*recommended) return **recommended;
  auto matrix = runtime::buildLocalMatrix(world, streamer.active());
  if (!matrix) return matrix.error();
  return runtime::chooseSolver(*matrix);
}

constexpr float kRadiusCells = 24;

}  // namespace

Result<stream::StreamSettings> cutSettings(const formats::World& world, const SolverOptions& solver, const CutOptions& options) {
  stream::StreamSettings settings;
  settings.radius_m = kRadiusCells * world.info().cell_m;
  settings.max_level0_nodes = options.max_patches;
  if (solver.kind == "auto") {
    const auto recommended = runtime::readRecommendation(world.path());
    if (!recommended) return recommended.error();
    if (*recommended) {
      settings.radius_m = (**recommended).radius_m.value_or(settings.radius_m);
      settings.growth = (**recommended).growth.value_or(settings.growth);
      if (options.max_patches == CutOptions().max_patches)
        settings.max_level0_nodes = (**recommended).max_patches.value_or(options.max_patches);
    }
  }
  if (options.radius_m > 0) settings.radius_m = options.radius_m;
  return settings;
}

Result<std::unique_ptr<runtime::Solver>> makeSolver(const formats::World& world, const stream::Streamer& streamer,
                                                    std::shared_ptr<runtime::VkContext> context,
                                                    const SolverOptions& options) {
  const auto choice = chosen(world, streamer, options.kind);
  if (!choice) return choice.error();
  // The paper's method is for charts: it lights the patches near the eye alone.
  if (choice->kind != SolverKind::kMultibounce) {
    if (options.on_cpu) return runtime::makeCpuGather();
    return runtime::makeVulkanGather(std::move(context), runtime::gatherRoomFor(world, runtime::slotsFor(streamer.maxNodes())));
  }
  runtime::MultibounceSettings settings;
  settings.places = choice->places;
  settings.storage = choice->storage;
  settings.luminance = choice->luminance;
  auto matrix = options.on_cpu ? runtime::makeCpuMultibounce(settings)
                               : runtime::makeVulkanMultibounce(std::move(context), settings);
  if (!matrix) return matrix.error();
  return std::unique_ptr<runtime::Solver>(runtime::makeDenseSolver(std::move(*matrix)));
}

}  // namespace ff::view
