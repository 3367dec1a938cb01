// The commands of ffinspect, apart from its argument parsing. Each prints its answer to stdout, as text or as one JSON
// document, and returns what went wrong.
#pragma once
#include <array>
#include <cstdint>
#include <cstdio>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "formats/read/whole_world.h"

namespace ff::tools {

struct InspectOutput {
  bool json = false;
  std::FILE* to = stdout;
};

// A node by its name: nothing in it depends on what lies in other chunks.
struct NodeName {
  uint32_t level = 0;
  formats::TileName tile;
  uint32_t index = 0;  // within the tile
};

// One screen: what the world is, its levels and files.
Result<void> inspectInfo(const formats::World& world, const InspectOutput& out);
// Reads every strip: entries per row, bytes by part, where the quanta go.
Result<void> inspectStats(const formats::WholeWorld& world, const InspectOutput& out);

// These read the index of what they look at, and no more of it. Errors: kUsage where nothing has that name.
Result<void> inspectRow(const formats::World& world, const NodeName& node, const InspectOutput& out);
Result<void> inspectTile(const formats::World& world, uint32_t level, const formats::TileName& tile, const InspectOutput& out);
// Both directions of one pair, and whether they agree. Nodes of one level.
Result<void> inspectPair(const formats::World& world, const NodeName& i, const NodeName& j, const InspectOutput& out);
// The nearest patch of a point, and its name. point: m, in the scene's world space.
Result<void> inspectLocate(const formats::World& world, const std::array<double, 3>& at, const InspectOutput& out);

struct ExportRequest {
  std::string what;    // rows, lamps, patches, geometry
  std::string format;  // mtx, npy, ply
  uint32_t level = 0;
  std::string path;
};
Result<void> inspectExport(const formats::WholeWorld& world, const ExportRequest& request, const InspectOutput& out);

// Flies a recorded path (recorded_path.h) again, at its own pace, and prints what frames took, what was late and where. Errors: kUsage, kIo, kInvalidFile.
struct TraceRequest {
  std::string path{};
  std::string trace_path{};  // of this run, as formfieldWriteTrace writes it; empty: none
  int threads = 0;         // of the solver; 0: all cores
  float radius_m = 0;      // these as FormfieldWorldSettings has them; 0: its defaults
  uint64_t memory_bytes = 0, bytes_per_second = 0;
  uint32_t max_applied_tiles = 0;
};
Result<void> inspectTrace(const std::string& world, const TraceRequest& request, const InspectOutput& out);

// Prints the report of verifyWorld (world_check.h). The code returned is that of the worst finding.
Result<void> inspectVerify(const formats::WholeWorld& world, int threads, bool quiet, const InspectOutput& out);

// JSON of common things, and refusals.
nlohmann::json toJson(Vec3 v);
nlohmann::json toJson(const Box& box);
nlohmann::json toJson(const formats::Node& node);
std::string hexText(std::span<const uint8_t> bytes);
Result<void> checkLevel(const formats::World& world, uint32_t level);

}  // namespace ff::tools
