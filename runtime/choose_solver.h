// Which solver suits a world: what ffchart measured and wrote beside it, else size and density.
#pragma once
#include <optional>
#include <string>

#include "formats/storage/storage.h"
#include "runtime/cut/local_matrix.h"
#include "runtime/dense/bounce_matrix.h"

namespace ff::runtime {

enum class SolverKind { kGather, kMultibounce, kSeed };

struct SolverChoice {
  SolverKind kind = SolverKind::kGather;
  Storage storage = Storage::kFloat32;  // of a dense matrix
  bool luminance = false;
  uint32_t places = 4096;  // of a dense matrix
  int iterations = 1;      // a frame; or Updater::kAsLightNeeds
  // Of the cut (stream/streamer.h); none: the caller's.
  std::optional<float> radius_m{}, growth{};
  std::optional<uint32_t> max_patches{};
  std::string why{};       // one line
};

// "a/town.ffm" -> "a/town.settings.json".
std::string settingsPath(const std::string& world_path);

// The choice stored beside a world (runtime/README.md has the keys); nothing where there is no such file. Errors: kIo;
// kInvalidFile where it is no JSON object or a value has no meaning. Keys that are not known are ignored.
Result<std::optional<SolverChoice>> readRecommendation(const std::string& world_path);

inline constexpr uint32_t kMaxDenseLeaves = 4096;

// By what a frame would have to read: the dense matrix once, against the rows as often as a step of light to under 1 %
// of its first size takes: log 0.01 / log q iterations, q the share of light that a step keeps (the mean of albedo
// times row sum over the leaves' area; at least one iteration). More than kMaxDenseLeaves leaves: gather.
SolverChoice chooseSolver(const LocalMatrix& matrix);

}  // namespace ff::runtime
