#include "runtime/choose_solver.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

namespace ff::runtime {
namespace {

Error wrong(const std::string& path, const char* key, const std::string& message) {
  return Error{ErrorCode::kInvalidFile, path, key, message, "write it again with ffchart, or delete it"};
}

}  // namespace

std::string settingsPath(const std::string& world_path) {
  std::filesystem::path path(world_path);
  if (path.extension() == ".ffm") path.replace_extension();
  return path.string() + ".settings.json";
}

Result<std::optional<SolverChoice>> readRecommendation(const std::string& world_path) {
  const std::string path = settingsPath(world_path);
  formats::Storage& storage = *formats::storageFor(path);
  const auto there = storage.exists(path);
  if (!there) return there.error();
  if (!*there) return std::optional<SolverChoice>();
  const auto bytes = formats::readWholeFile(storage, path);
  if (!bytes) return bytes.error();
  const nlohmann::json json = nlohmann::json::parse(reinterpret_cast<const char*>(bytes->data()),
                                                    reinterpret_cast<const char*>(bytes->data() + bytes->size()), nullptr, false);
  if (json.is_discarded() || !json.is_object()) return wrong(path, "", "is no JSON object");
  SolverChoice choice;
  choice.why = "recommended in " + path;
  const auto text = [&](const char* key) {
    const auto at = json.find(key);
    return at != json.end() && at->is_string() ? at->get<std::string>() : std::string();
  };
  if (const std::string solver = text("solver"); solver == "multibounce")
    choice.kind = SolverKind::kMultibounce;
  else if (solver == "seed")
    choice.kind = SolverKind::kSeed;
  else if (solver != "gather")
    return wrong(path, "solver", "is not gather, multibounce or seed");
  if (json.contains("storage")) {
    const std::string kept_as = text("storage");
    if (kept_as != "fp32" && kept_as != "fp16") return wrong(path, "storage", "is not fp32 or fp16");
    if (kept_as == "fp16") choice.storage = Storage::kFloat16;
  }
  if (const auto at = json.find("luminance"); at != json.end()) {
    if (!at->is_boolean()) return wrong(path, "luminance", "is not true or false");
    choice.luminance = at->get<bool>();
  }
  const auto whole = [&](const char* key, uint64_t least, uint64_t most, auto& to) {
    const auto at = json.find(key);
    if (at == json.end()) return true;
    if (!at->is_number_unsigned() || at->get<uint64_t>() < least || at->get<uint64_t>() > most) return false;
    to = at->get<std::remove_reference_t<decltype(to)>>();
    return true;
  };
  if (!whole("places", 1, kMaxPlaces, choice.places))
    return wrong(path, "places", "is not a whole number from 1 to " + std::to_string(kMaxPlaces));
  if (!whole("iterations", 1, 1000, choice.iterations))
    return wrong(path, "iterations", "is not a whole number from 1 to 1000");
  const auto number = [&](const char* key, double least, double most, std::optional<float>& to) {
    const auto at = json.find(key);
    if (at == json.end()) return true;
    if (!at->is_number() || !(at->get<double>() >= least && at->get<double>() <= most)) return false;
    to = at->get<float>();
    return true;
  };
  if (!number("radius_m", 1e-3, 1e6, choice.radius_m))
    return wrong(path, "radius_m", "is not a length from 0.001 to 1,000,000 m");
  if (!number("growth", 1, 16, choice.growth)) return wrong(path, "growth", "is not a number from 1 to 16");
  if (uint32_t most = 0; !whole("max_patches", 1, 0xffffffffu, most))
    return wrong(path, "max_patches", "is not a whole number from 1 on");
  else if (most > 0)
    choice.max_patches = most;
  return std::optional(choice);
}

SolverChoice chooseSolver(const LocalMatrix& m) {
  SolverChoice choice;
  double kept = 0, area = 0;
  for (const uint32_t s : m.leaves) {
    uint64_t sum = 0;
    for (const uint32_t entry : m.row(s)) sum += countOfEntry(entry);
    const Vec4 rho = m.albedo[s];
    const auto most = static_cast<double>(std::max({rho.x, rho.y, rho.z}));
    kept += static_cast<double>(m.area_m2[s]) * most * static_cast<double>(sum) * static_cast<double>(m.row_scale[s]);
    area += static_cast<double>(m.area_m2[s]);
  }
  const double q = area > 0 ? std::min(kept / area, 0.9999) : 0;
  const double iterations = q > 0 ? std::max(1.0, std::log(0.01) / std::log(q)) : 1;
  const auto leaves = static_cast<double>(m.leaves.size());
  const double dense = 3 * sizeof(float) * leaves * leaves;
  const double sparse = sizeof(uint32_t) * static_cast<double>(m.used_entries) * iterations;
  const auto mib = [](double bytes) { return std::to_string(static_cast<uint64_t>(bytes / 1048576)) + " MiB"; };
  choice.why = std::to_string(m.leaves.size()) + " leaves: the dense matrix is " + mib(dense) + ", " +
               std::to_string(static_cast<int>(iterations)) + " iterations over the rows read " + mib(sparse);
  if (m.leaves.size() > kMaxDenseLeaves || m.leaves.empty() || dense >= sparse) return choice;
  choice.kind = SolverKind::kMultibounce;
  return choice;
}

}  // namespace ff::runtime
