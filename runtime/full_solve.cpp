// Jacobi iterations, because they make the result independent of the order of rows: each row is summed by one thread in
// the order of its entries.
#include "runtime/full_solve.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "formats/read/whole_world.h"
#include "runtime/solver/worker_pool.h"

namespace ff::runtime {
namespace {

// All level-0 rows as CSR; 6 bytes an entry.
struct Rows {
  std::vector<uint64_t> start{0};
  std::vector<uint32_t> columns;
  std::vector<uint16_t> counts;
  std::vector<double> reflectance;  // 3 per patch: albedo / Q
  std::vector<uint32_t> quanta;     // Q

  // Sum over a row's entries of count times value, by channel.
  std::array<double, 3> gather(uint32_t row, std::span<const double> values) const {
    std::array<double, 3> sum{};
    for (uint64_t k = start[row]; k < start[row + 1]; ++k) {
      const double* b = &values[size_t{3} * columns[k]];
      const double count = counts[k];
      for (size_t c = 0; c < 3; ++c) sum[c] += count * b[c];
    }
    return sum;
  }
};

void append(const formats::WholeWorld& world, const formats::Strip& strip, Rows& rows) {
  for (const formats::Node& node : strip.nodes) {
    rows.quanta.push_back(node.quanta);
    for (int c = 0; c < 3; ++c)
      rows.reflectance.push_back(node.quanta ? static_cast<double>(node.albedo[c]) / node.quanta : 0.0);
  }
  std::vector<uint64_t> cursor(strip.nodes.size() + 1, 0);
  for (const uint8_t row : strip.rows) ++cursor[row + 1u];
  const uint64_t base = rows.columns.size();
  cursor[0] = base;
  for (size_t i = 1; i < cursor.size(); ++i) {
    cursor[i] += cursor[i - 1];
    rows.start.push_back(cursor[i]);
  }
  rows.columns.resize(base + strip.rows.size());
  rows.counts.resize(base + strip.rows.size());
  size_t k = 0;
  for (const formats::Block& block : strip.blocks) {
    const uint32_t first = formats::wholeNumber(world.tiles(0)[block.partner_tile].first_node);
    for (const size_t end = k + block.entries; k < end; ++k) {
      const uint64_t at = cursor[strip.rows[k]]++;
      rows.columns[at] = first + strip.columns[k];
      rows.counts[at] = strip.counts[k];
    }
  }
}

constexpr uint32_t kPartRows = 256;

struct Extremes {
  double change = 0, largest = 0;
};

}  // namespace

namespace {

// each(node, irradiance without a bounce)
template <class Each>
Result<void> eachArriving(const formats::WholeWorld& world, std::span<const Vec3> direct, const Sky& sky, const Lamps& lamps,
                          Each&& each) {
  std::vector<Vec3> from_lamps;
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto strip = world.strip(info.id);
    if (!strip) return strip.error();
    from_lamps.resize(strip->nodes.size());
    lamps.irradiance(strip->lamps, from_lamps);
    for (size_t i = 0; i < strip->nodes.size(); ++i) {
      const Vec3 own = direct.empty() ? Vec3{} : direct[info.first_node + i];
      each(strip->nodes[i], own + from_lamps[i] + skyIrradiance(sky, strip->nodes[i]));
    }
  }
  return {};
}

}  // namespace

Result<std::vector<Vec3>> arriving(const formats::WholeWorld& world, std::span<const Vec3> direct, const Sky& sky, const Lamps& lamps) {
  std::vector<Vec3> light;
  light.reserve(world.levels()[0].nodes);
  auto read = eachArriving(world, direct, sky, lamps, [&](const formats::Node&, Vec3 e) { light.push_back(e); });
  if (!read) return read.error();
  return light;
}

Result<std::vector<double>> fullSource(const formats::WholeWorld& world, std::span<const Vec3> direct, const Sky& sky,
                                       const Lamps& lamps) {
  std::vector<double> source;
  source.reserve(size_t{3} * world.levels()[0].nodes);
  auto read = eachArriving(world, direct, sky, lamps, [&](const formats::Node& node, Vec3 e) {
    const Vec3 m = node.albedo * e;
    for (int c = 0; c < 3; ++c) source.push_back(static_cast<double>(m[c]));
  });
  if (!read) return read.error();
  return source;
}

Result<FullSolution> solveFullWorld(const formats::WholeWorld& world, std::span<const double> source,
                                    const FullSolveSettings& settings) {
  const uint32_t patches = formats::wholeNumber(world.levels()[0].nodes);
  FF_CHECK_EQ(source.size(), size_t{3} * patches);
  Rows rows;
  rows.columns.reserve(world.levels()[0].entries);
  rows.counts.reserve(world.levels()[0].entries);
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto strip = world.strip(info.id);
    if (!strip) return strip.error();
    append(world, *strip, rows);
  }

  WorkerPool pool(settings.threads);
  const uint32_t parts = (patches + kPartRows - 1) / kPartRows;
  std::vector<Extremes> extremes(parts);
  std::vector<double> from(source.begin(), source.end()), to(source.size());
  FullSolution solution;
  while (solution.iterations < settings.max_iterations) {
    pool.run(parts, [&](uint32_t part) {
      Extremes found;
      const uint32_t end = std::min(patches, (part + 1) * kPartRows);
      for (uint32_t row = part * kPartRows; row < end; ++row) {
        const std::array<double, 3> sum = rows.gather(row, from);
        for (size_t c = 0; c < 3; ++c) {
          const size_t at = size_t{3} * row + c;
          to[at] = source[at] + rows.reflectance[at] * sum[c];
          found.change = std::max(found.change, std::abs(to[at] - from[at]));
          found.largest = std::max(found.largest, std::abs(to[at]));
        }
      }
      extremes[part] = found;
    });
    from.swap(to);
    ++solution.iterations;
    Extremes all;
    for (const Extremes& e : extremes) all = {std::max(all.change, e.change), std::max(all.largest, e.largest)};
    solution.last_change = all.largest > 0 ? all.change / all.largest : 0;
    if (solution.last_change <= settings.tolerance) break;
  }
  for (uint32_t row = 0; row < patches; ++row)
    for (const double sum : rows.gather(row, from)) solution.gathered.push_back(rows.quanta[row] ? sum / rows.quanta[row] : 0.0);
  solution.radiosity = std::move(from);
  return solution;
}

}  // namespace ff::runtime
