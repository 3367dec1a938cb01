#include "tools/chart/neighbourhood.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "formats/read/whole_world.h"

namespace ff::chart {

using namespace runtime;
using namespace walks;

uint32_t Neighbourhood::activePatches() const {
  uint32_t patches = 0;
  for (const SlotRange& range : pyramid->matrix().tiles)
    if (range.id.level == 0) patches += range.nodes;
  return patches;
}

Result<Neighbourhood> neighbourhoodAt(const formats::WholeWorld& world, const WorldTruth& truth, Vec3 observer,
                                      const stream::StreamSettings& settings) {
  auto streamer = stream::Streamer::create(world, settings);
  if (!streamer) return streamer.error();
  Neighbourhood there;
  there.streamer = std::move(*streamer);
  there.streamer->update(observer, {});
  if (auto settled = there.streamer->settle(); !settled) return settled.error();
  there.at = {observer, localRadius(truth, there.streamer->active(), observer)};
  there.pyramid = std::make_unique<MatrixAssembler>(world);
  if (auto built = there.pyramid->update(there.streamer->active()); !built) return built.error();
  there.source = sourceOf(truth, world, there.pyramid->matrix(), there.streamer->active());
  return there;
}

Result<void> lightUp(const LocalMatrix& matrix, std::span<const Vec4> source, Solver& solver) {
  if (auto taken = solver.update(matrix, {.any = true, .renumbered = true}); !taken) return taken;
  if (auto lit = solver.setSource(source); !lit) return lit;
  return solver.setRadiosity(source);
}

Result<void> lightUp(const Neighbourhood& there, Solver& solver) { return lightUp(there.pyramid->matrix(), there.source, solver); }

Result<LocalPatches> localPatches(const formats::WholeWorld& world, const WorldTruth& truth, const Neighbourhood& there) {
  auto matrix = buildLocalMatrix(world, there.streamer->active(), FarLight::kConstant);
  if (!matrix) return matrix.error();
  LocalPatches l;
  l.matrix = std::move(*matrix);
  l.slot_source = sourceOf(truth, world, l.matrix, there.streamer->active());
  const Vec4 ambient = meanOutside(truth, l.matrix);
  std::vector<uint32_t> patch_of(l.matrix.slots(), 0);
  for (const SlotRange& range : l.matrix.tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      patch_of[range.first_slot + i] = l.patches();
      l.slots.push_back(range.first_slot + i);
    }
  std::vector<FormFactorRow> rows(l.slots.size());
  std::vector<Vec4> albedo;
  for (size_t p = 0; p < l.slots.size(); ++p) {
    const uint32_t slot = l.slots[p];
    const Vec4 rho = l.matrix.albedo[slot];
    float outside = 0;
    for (const uint32_t entry : l.matrix.row(slot)) {
      const float f = static_cast<float>(countOfEntry(entry)) * l.matrix.row_scale[slot];
      if (slotOfEntry(entry) == l.matrix.ambient_slot)
        outside += f;
      else
        rows[p].push_back({patch_of[slotOfEntry(entry)], f});
    }
    const Vec4 m = l.slot_source[slot];
    l.source.push_back(
        {m.x + rho.x * outside * ambient.x, m.y + rho.y * outside * ambient.y, m.z + rho.z * outside * ambient.z, 0});
    albedo.push_back(rho);
    std::sort(rows[p].begin(), rows[p].end());
  }
  l.set = makeSceneRows(rows, std::move(albedo));
  return l;
}

Result<void> fillMatrix(BounceMatrix& matrix, Placement& placement, uint32_t patches, uint32_t block) {
  std::vector<uint32_t> entering;
  for (uint32_t first = 0; first < patches; first += block) {
    entering.resize(std::min(block, patches - first));
    std::iota(entering.begin(), entering.end(), first);
    if (auto inserted = matrix.insert(placement.enter(entering)); !inserted) return inserted;
  }
  return {};
}

Result<std::vector<Vec4>> relitRadiosity(const LocalPatches& local, const Placement& placement, BounceMatrix& matrix) {
  std::vector<Vec4> source(matrix.capacity()), irradiance(matrix.capacity());
  for (uint32_t p = 0; p < local.patches(); ++p) source[placement.place(p)] = local.source[p];
  if (auto lit = matrix.relight(source, irradiance); !lit) return lit.error();
  std::vector<Vec4> radiosity(local.matrix.slots());
  for (uint32_t p = 0; p < local.patches(); ++p) {
    const Vec4 e = irradiance[placement.place(p)], rho = local.set.albedo[p], m = local.source[p];
    radiosity[local.slots[p]] = {m.x + rho.x * e.x, m.y + rho.y * e.y, m.z + rho.z * e.z, 0};
  }
  return radiosity;
}

double gatherBytes(const LocalMatrix& m) {
  double entries = 0;
  for (const uint32_t slot : m.leaves) entries += (m.row_entries[slot] + kRowPadding - 1) / kRowPadding * kRowPadding;
  return 4 * entries + static_cast<double>(m.leaves.size()) * (3 * sizeof(uint32_t) + 4 * sizeof(Vec4));
}

}  // namespace ff::chart
