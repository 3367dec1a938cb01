#include "bake/matrix/level_rows.h"

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

void LevelRows::put(uint32_t tile, std::span<const NodeRow> rows) {
  ByteWriter out;
  putVarint(out, rows.size());
  for (const NodeRow& of_node : rows) {
    const ExchangeRow& row = of_node.row;
    putLamps(out, row.lamps);
    fields(out, of_node);
    putVarint(out, row.column.size());
    uint32_t last = 0;
    for (size_t k = 0; k < row.column.size(); last = row.column[k++]) {
      putVarint(out, row.column[k] - last);
      out.f32(static_cast<float>(row.area_m2[k]));
    }
  }
  tile_[tile] = spill_.put(out.data());
}

std::vector<NodeRow> LevelRows::get(uint32_t tile) const {
  const std::vector<std::byte> raw = spill_.get(tile_[tile]);
  ByteReader in(raw);
  std::vector<NodeRow> rows(takeVarint(in));
  for (NodeRow& of_node : rows) {
    ExchangeRow& row = of_node.row;
    row.lamps = takeLamps(in);
    fields(in, of_node);
    row.column.resize(takeVarint(in));
    row.area_m2.resize(row.column.size());
    uint32_t column = 0;
    for (size_t k = 0; k < row.column.size(); ++k) {
      row.column[k] = column += static_cast<uint32_t>(takeVarint(in));
      float area = 0;
      in.f32(area);
      row.area_m2[k] = static_cast<double>(area);
    }
  }
  return rows;
}

}  // namespace ff::bake
