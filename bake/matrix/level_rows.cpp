#include "bake/matrix/level_rows.h"

#include <cmath>

#include "bake/packing.h"

namespace ff::bake {
namespace {

using formats::ByteReader, formats::ByteWriter;

// All of a node but its row's lamps and columns, of a reader or a writer alike.
template <class Bytes, class NodeRowT>
void fields(Bytes& b, NodeRowT& n) {
  b.f32(n.node.area_m2);
  b.vec3(n.node.centroid);
  b.vec3(n.node.normal);
  b.vec3(n.node.albedo);
  b.vec3(n.node.emission);
  b.u16(n.node.lamp_group);
  b.u32(n.node.parent);
  b.box(n.bounds);
  for (auto& x : n.direct) b.f32(x);
  b.f64(n.row.sky_m2);
  b.f64(n.row.absorbed_m2);
  skyFields(b, n.row.sky_means);
}

}  // namespace

void LevelRows::put(uint32_t tile, uint32_t first_node, std::span<const NodeRow> rows) {
  ByteWriter out;
  putVarint(out, rows.size());
  for (size_t i = 0; i < rows.size(); ++i) {
    const ExchangeRow& row = rows[i].row;
    putLamps(out, row.lamps);
    fields(out, rows[i]);
    putVarint(out, row.column.size());
    const size_t node = first_node + i;
    uint32_t last = 0;
    for (size_t k = 0; k < row.column.size(); last = row.column[k++]) {
      putVarint(out, row.column[k] - last);
      if (density_.empty()) out.f32(static_cast<float>(row.area_m2[k]));
      else putVarint(out, static_cast<uint64_t>(std::llround(row.area_m2[k] * (density_[node] + density_[row.column[k]]))));
    }
  }
  tile_[tile] = {first_node, spill_.put(out.data())};
}

std::vector<NodeRow> LevelRows::get(uint32_t tile) const {
  const std::vector<std::byte> raw = spill_.get(tile_[tile].block);
  ByteReader in(raw);
  std::vector<NodeRow> rows(takeVarint(in));
  for (size_t i = 0; i < rows.size(); ++i) {
    ExchangeRow& row = rows[i].row;
    row.lamps = takeLamps(in);
    fields(in, rows[i]);
    const size_t node = tile_[tile].first_node + i;
    row.column.resize(takeVarint(in));
    row.area_m2.resize(row.column.size());
    uint32_t column = 0;
    for (size_t k = 0; k < row.column.size(); ++k) {
      row.column[k] = column += static_cast<uint32_t>(takeVarint(in));
      float area = 0;
      if (density_.empty()) in.f32(area);
      row.area_m2[k] = density_.empty() ? static_cast<double>(area) : static_cast<double>(takeVarint(in)) / (density_[node] + density_[column]);
    }
  }
  return rows;
}

}  // namespace ff::bake
