#include "bake/matrix/level_rows.h"

#include <utility>

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
  b.box(n.bounds);
  for (auto& x : n.direct) b.f32(x);
  b.f64(n.row.sky_m2);
  b.f64(n.row.absorbed_m2);
  skyFields(b, n.row.sky_means);
}

}  // namespace

void LevelRows::put(uint32_t tile, std::span<const NodeRow> rows) {
  ByteWriter out;
  std::vector<float> areas_m2;
  putVarint(out, rows.size());
  for (const NodeRow& of_node : rows) {
    putLamps(out, of_node.row.lamps);
    fields(out, of_node);
    putVarint(out, of_node.row.column.size());
    for (const double area : of_node.row.area_m2) areas_m2.push_back(static_cast<float>(area));
  }
  {
    VarintAppender columns(out);
    for (const NodeRow& of_node : rows) {
      uint32_t last = 0;
      for (const uint32_t column : of_node.row.column) columns.put(column - std::exchange(last, column));
    }
  }
  putValues(out, areas_m2);
  tile_[tile] = spill_.put(out.data());
}

void LevelRows::get(uint32_t tile, std::vector<NodeRow>& rows) const {
  const std::vector<std::byte> raw = spill_.get(tile_[tile]);
  ByteReader in(raw);
  rows.resize(takeVarint(in));
  for (NodeRow& of_node : rows) {
    of_node.row.lamps = takeLamps(in);
    fields(in, of_node);
    of_node.row.column.resize(takeVarint(in));
  }
  for (NodeRow& of_node : rows) {
    uint32_t last = 0;
    for (uint32_t& column : of_node.row.column) column = last += static_cast<uint32_t>(takeVarint(in));
  }
  std::vector<float> areas_m2;
  for (NodeRow& of_node : rows) {
    takeValues(in, raw, of_node.row.column.size(), areas_m2);
    of_node.row.area_m2.assign(areas_m2.begin(), areas_m2.end());
  }
}

}  // namespace ff::bake
