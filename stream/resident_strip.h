// A strip as it stays in memory: its nodes, their lamps' light, and its rows in 16-bit words, grouped by row. A third smaller than the
// arrays of formats::Strip, in the order in which a local matrix is put together, and what crosses the bus to a GPU.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"

namespace ff::stream {

struct ResidentStrip {
  formats::TileId id;
  uint32_t first_node = 0;  // number of nodes[0] within its level
  std::vector<formats::Node> nodes;
  std::vector<uint32_t> partners;  // partner tiles (of the strip's own level), ascending
  // Row r has the runs runs[run_start[r] .. run_start[r + 1]), one a partner tile, and the words words[row_start[r] ..
  // row_start[r + 1]), run after run. A word is `column << 8 | count`; a count above 255 takes several with one column.
  // Form factor: F = count / nodes[r].quanta.
  struct Run {
    uint16_t partner;  // index into `partners`, ascending in a row
    uint16_t words;
  };
  std::vector<Run> runs;
  std::vector<uint16_t> words;
  std::vector<uint32_t> run_start, row_start;  // nodes + 1 each
  std::vector<uint64_t> row_partners;          // per node: bit p % 64 is set for each partner p of its runs
  std::vector<formats::LampLight> lamps;       // what the nodes get of the lamps, by row
};

using StripPtr = std::shared_ptr<const ResidentStrip>;

// Takes the strip apart. Errors (kInvalidFile): more partner tiles or words in a run than 16 bits can count.
Result<ResidentStrip> pack(formats::Strip&& strip);

// Bytes that a strip takes in memory.
uint64_t residentBytes(const ResidentStrip& strip);

}  // namespace ff::stream
