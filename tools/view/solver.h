// The solver that ffview lights a world with.
#pragma once
#include <memory>
#include <string>

#include "runtime/solver/solver.h"
#include "runtime/vulkan/context.h"
#include "stream/streamer.h"

namespace ff::view {

struct SolverOptions {
  std::string kind = "auto";  // auto, gather, multibounce
  bool on_cpu = false;        // else on the context's device
};

// The cut that a flight streams: what the options say; with `auto`, what was recommended beside the world for those that
// they leave open (radius_m 0, max_patches 0xffffffff); else 24 patch cells and all patches. Errors: an unreadable recommendation.
struct CutOptions {
  float radius_m = 0;
  uint32_t max_patches = 0xffffffffu;
};
Result<stream::StreamSettings> cutSettings(const formats::World& world, const SolverOptions& solver, const CutOptions& options);

// auto: what was recommended beside the world, else by the cut that is active now (settled at the first eye).
// Errors: out of memory, an unreadable recommendation.
Result<std::unique_ptr<runtime::Solver>> makeSolver(const formats::World& world, const stream::Streamer& streamer,
                                                    std::shared_ptr<runtime::VkContext> context,
                                                    const SolverOptions& options);

}  // namespace ff::view
