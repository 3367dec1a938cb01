#include "bake/estimate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <string>
#include <thread>

#include <tsl/robin_set.h>

#include "bake/light/form_factor.h"
#include "bake/memory.h"
#include "bake/rays/sobol.h"
#include "bake/rays/surface_sampling.h"
#include "bake/surface/fineness.h"
#include "bake/surface/patches.h"
#include "formats/storage/storage.h"

namespace ff::bake {
namespace {

// Measured on towns and rooms; they need to be right within a factor of two only.
constexpr double kBytesAPiece = 200, kBytesATriangle = 215, kBytesAPatch = 140, kBytesAMergedPatch = 150;
constexpr double kLeastBytes = 64e6, kLeastAPatch = 20, kLeastAThread = 8e6;  // never in files; reckoned
constexpr double kDiskAPatch = 130, kDiskAQuantum = 0.25;
constexpr double kSurelyOnDisk = 0.5;  // of the estimate
constexpr double kRaysAtError = 1100, kErrorAsked = 0.02, kRaysByError = 1.4;  // an error, and how rays rise for less of it
constexpr double kRaysASecond = 1.1e6;  // of one core, over the whole bake

std::string rounded(double x, const char* unit = "") {
  const char* prefix[] = {"", "k", "M", "G", "T", "P"};
  size_t k = 0;
  while (x >= 1000 && k + 1 < std::size(prefix)) x /= 1000, ++k;
  char text[32];
  std::snprintf(text, sizeof text, x < 10 && k > 0 ? "%.1f" : "%.0f", x);
  return std::string(text) + (*unit ? " " : "") + prefix[k] + unit;
}

// A patch's, on average.
double raysOf(const BakeSettings& settings) {
  if (!(settings.target_error > 0)) return settings.rays;
  const double asked = kRaysAtError * std::pow(kErrorAsked / static_cast<double>(settings.target_error), kRaysByError);
  return std::clamp<double>(asked, RayBudget(settings.rays, settings.target_error).fewest(), settings.rays);
}

// How many different keys there are, in little memory: those are kept whose lowest bits are zero, one bit more whenever there are too many.
// Philippe Flajolet. On adaptive sampling. Computing 43, 1990. Off by 1.2 / sqrt(kKept), or 1 %.
class DistinctKeys {
 public:
  void add(uint64_t key) {  // well mixed
    if (key & mask_) return;
    kept_.insert(key);
    while (kept_.size() > kKept) {
      mask_ = 2 * mask_ + 1;
      for (auto it = kept_.begin(); it != kept_.end();) it = *it & mask_ ? kept_.erase(it) : std::next(it);
    }
  }
  double count() const { return static_cast<double>(kept_.size()) * static_cast<double>(mask_ + 1); }

 private:
  static constexpr size_t kKept = 1 << 14;
  uint64_t mask_ = 0;
  tsl::robin_set<uint64_t> kept_;
};

double allowed(const BakeSettings& settings) { return static_cast<double>(settings.memory_bytes > 0 ? settings.memory_bytes : freeMemory()); }

}  // namespace

BakeEstimate estimateBake(const Scene& scene, const BakeSettings& settings) {
  BakeEstimate e;
  double area = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const Material& material = scene.materials[scene.triangles[t].material];
    area += static_cast<double>(triangleArea(scene, t)) * patchedSides(material) / faceCells(finenessOf(material.density));
  }
  e.cell_m = settings.cell_m > 0 ? static_cast<double>(settings.cell_m) : std::sqrt(area / static_cast<double>(std::max<uint64_t>(1, settings.patch_budget)));
  std::array<DistinctKeys, 2> small;  // cells and orientations of triangles smaller than a cell, which share patches; by sides
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const auto& v = scene.triangles[t].v;
    const Material& material = scene.materials[scene.triangles[t].material];
    const int fineness = finenessOf(material.density), sides = patchedSides(material);
    const double s = e.cell_m * edgeCells(fineness);
    const Vec3 a = scene.positions[v[0]], b = scene.positions[v[1]], c = scene.positions[v[2]], n = cross(b - a, c - a);
    const double whole = static_cast<double>(length(n)) / 2;
    // A plane cuts (|x| + |y| + |z|) cells a cell's face of area, its unit normal's components; its border some more.
    const double across = whole > 0 ? (std::abs(static_cast<double>(n.x)) + std::abs(static_cast<double>(n.y)) + std::abs(static_cast<double>(n.z))) / (2 * whole) : 1;
    const double border = static_cast<double>(length(b - a) + length(c - b) + length(a - c));
    double cells = 1;  // that its box touches; what ends in a grid plane does not reach beyond it
    for (int k = 0; k < 3; ++k) {
      const auto [least, most] = std::minmax({a[k], b[k], c[k]});
      cells *= std::max(1.0, std::ceil(static_cast<double>(most) / s - 1e-3) - std::floor(static_cast<double>(least) / s + 1e-3));
    }
    const double pieces = std::min(cells, 1 + whole * across / (s * s) + border / s);
    e.pieces += pieces;
    if (border > 4 * s || settings.cell_m == 0) {
      e.patches += sides * std::max(whole * across / (s * s), whole > s * s ? 1.0 : 0.0);
    } else if (sides > 0) {
      const Vec3 at = (a + b + c) / 3.0f;
      uint64_t key = std::abs(n.x) > std::abs(n.y) ? (n.x < 0) : 2 + (n.y < 0);
      if (std::abs(n.z) > std::max(std::abs(n.x), std::abs(n.y))) key = 4 + (n.z < 0);
      key += 6 * static_cast<uint64_t>(fineness + kMaxFineness);
      for (int k = 0; k < 3; ++k) key = mix64(key) + static_cast<uint64_t>(std::llround(std::floor(static_cast<double>(at[k]) / s)));
      small[static_cast<size_t>(sides) - 1].add(mix64(key));
    }
  }
  e.patches = settings.cell_m == 0 ? static_cast<double>(settings.patch_budget) : e.patches + small[0].count() + 2 * small[1].count();
  const unsigned cores = std::max(1u, settings.threads > 0 ? static_cast<unsigned>(settings.threads) : std::thread::hardware_concurrency());
  const double rays = raysOf(settings);
  e.least_memory_bytes = kLeastBytes + cores * kLeastAThread + e.patches * kLeastAPatch;
  e.memory_bytes = e.least_memory_bytes + static_cast<double>(scene.triangles.size()) * kBytesATriangle + e.pieces * kBytesAPiece + e.patches * kBytesAPatch;
  if (settings.merge_error > 0) e.memory_bytes += e.patches * kBytesAMergedPatch;  // those that there are before
  e.disk_bytes = e.patches * (kDiskAPatch + kDiskAQuantum * settings.quanta);
  e.seconds = e.patches * rays / (kRaysASecond * cores);
  return e;
}

Result<void> checkFits(const Scene& scene, const BakeSettings& settings, const BakeEstimate& e) {
  const double free = allowed(settings);
  const auto areTooMany = [&](double cell_m) { return fewestPieces(scene, cell_m) > kMostPieces; };
  const bool too_many = areTooMany(e.cell_m);
  if (!too_many && e.least_memory_bytes <= free) return {};
  std::string remedy = too_many ? "bake parts of the scene as worlds of their own" : "allow more";
  BakeSettings larger = settings;
  larger.cell_m = static_cast<float>(e.cell_m);
  const bool by_patches = e.least_memory_bytes - e.patches * kLeastAPatch <= 0.8 * free;
  for (int doubled = 0; by_patches && doubled < 10; ++doubled) {
    larger.cell_m *= 2;
    if (areTooMany(static_cast<double>(larger.cell_m)) || estimateBake(scene, larger).least_memory_bytes > 0.8 * free) continue;
    char size[32];
    std::snprintf(size, sizeof size, "%.3g", static_cast<double>(larger.cell_m));
    remedy = settings.cell_m > 0 ? std::string("use --patch-size ") + size + " or larger, or a --patch-budget" : "use a smaller --patch-budget";
    break;
  }
  if (too_many)
    return Error{ErrorCode::kUsage, scene.name, "", "about " + rounded(e.patches) + " patches are more than a bake makes, which cuts surface into " + rounded(kMostPieces) + " pieces at most", std::move(remedy)};
  return Error{ErrorCode::kUsage, scene.name, "",
               "about " + rounded(e.patches) + " patches need " + rounded(e.least_memory_bytes, "B") + " of memory at least, of which " + rounded(free, "B") + (settings.memory_bytes > 0 ? " may be used" : " are free"),
               std::move(remedy)};
}

Result<void> checkSpace(const std::string& path, const BakeSettings& settings, const BakeEstimate& e) {
  std::error_code unknown;
  const auto disk = std::filesystem::space(formats::folderOf(path), unknown);
  const auto free = static_cast<double>(disk.available);
  const double aside = std::max(0.0, e.memory_bytes - allowed(settings));
  if (unknown || free >= kSurelyOnDisk * (e.disk_bytes + aside)) return {};
  const std::string with = aside > 0 ? " and " + rounded(aside, "B") + " that memory has no room for" : "";
  return Error{ErrorCode::kIo, path, "", "about " + rounded(e.disk_bytes, "B") + " of world" + with + " do not fit on this disk, of which " + rounded(free, "B") + " are free",
               "make room, or name an output elsewhere"};
}

}  // namespace ff::bake
