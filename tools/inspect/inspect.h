// The commands of ffinspect, apart from its argument parsing. Each prints its answer to stdout, as text or as one JSON
// document, and returns what went wrong.
#pragma once
#include <cstdint>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <string>

#include "formats/reader.h"

namespace ff::tools {

struct InspectOutput {
  bool json = false;
  std::FILE* to = stdout;
};

// One screen: what the world is, its levels and files.
Result<void> inspectInfo(const formats::World& world, const InspectOutput& out);
// Reads every strip: entries per row, bytes by part, where the quanta go.
Result<void> inspectStats(const formats::World& world, const InspectOutput& out);

Result<void> inspectRow(const formats::World& world, uint32_t level, uint32_t node, const InspectOutput& out);
Result<void> inspectTile(const formats::World& world, formats::TileId id, const InspectOutput& out);
// Both directions of one pair, and whether they agree.
Result<void> inspectPair(const formats::World& world, uint32_t level, uint32_t i, uint32_t j, const InspectOutput& out);
// The cell, tile and nearest patch of a point.
Result<void> inspectLocate(const formats::World& world, Vec3 point, const InspectOutput& out);

struct ExportRequest {
  std::string what;    // rows, lamps, patches, geometry
  std::string format;  // mtx, npy, ply
  uint32_t level = 0;
  std::string path;
};
Result<void> inspectExport(const formats::World& world, const ExportRequest& request, const InspectOutput& out);

// Prints the report of verifyWorld (world_check.h). The code returned is that of the worst finding.
Result<void> inspectVerify(const formats::World& world, int threads, bool quiet, const InspectOutput& out);

// JSON of common things, and refusals.
nlohmann::json toJson(Vec3 v);
nlohmann::json toJson(const Box& box);
nlohmann::json toJson(const formats::Node& node);
std::string hexText(std::span<const uint8_t> bytes);
Result<void> checkLevel(const formats::World& world, uint32_t level);
Result<void> checkNode(const formats::World& world, uint32_t level, uint32_t node);
// The strip that holds a node; the node's index in it is node - first_node.
Result<formats::Strip> stripOfNode(const formats::World& world, uint32_t level, uint32_t node);

}  // namespace ff::tools
