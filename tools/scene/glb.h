// A generated scene as one binary glTF 2.0 file (.glb).
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "formats/result.h"
#include "tools/scene/model.h"

namespace ff::tools {

struct GlbOptions {
  // KHR_draco_mesh_compression. Positions of an integer grid are quantised on that grid, others are kept as floats; every
  // part is decoded again and compared, so a part that Draco would change is an error and never a file.
  bool draco = false;
};

// The same model and options give the same bytes. Errors: kUsage for what glTF or Draco cannot hold.
Result<std::vector<uint8_t>> glbBytes(const SceneModel& model, const GlbOptions& options = {});
Result<void> writeGlb(const SceneModel& model, const std::string& path, const GlbOptions& options = {});

}  // namespace ff::tools
