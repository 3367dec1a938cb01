// The path of a run: what formfieldWriteTrace has written, or the same form by hand (tools/README.md).
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "formats/result.h"
#include "runtime/api/formfield.h"

namespace ff::tools {

struct RecordedFrame {
  double seconds = 0;                        // since the first
  std::vector<FormfieldObserver> observers;  // 1 to FORMFIELD_MAX_OBSERVERS
  double ms = 0;                             // that the frame's thread took but for the solver; 0: not known
  uint32_t late_tiles = 0;                   // likewise
};

// At least one frame, in order. Errors: kIo; kInvalidFile names what is missing.
Result<std::vector<RecordedFrame>> readRecordedPath(const std::string& path);

}  // namespace ff::tools
