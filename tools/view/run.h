// A headless flight, top to bottom: load, light, stream, solve, draw, compare, write.
#pragma once
#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "runtime/vulkan/context.h"
#include "tools/view/camera.h"
#include "tools/view/solver.h"

namespace ff::view {

struct RunOptions {
  std::string world, camera, out_folder;
  uint32_t width = 1280, height = 720;
  int frames = 4;                        // evenly over the path
  runtime::VulkanChoice device;
  SolverOptions solver;
  float radius_m = 0;                    // 0: what is recommended beside the world, else 24 patch cells
  uint32_t max_patches = 0xffffffffu;    // active ones; left at that: what is recommended, else all
  std::optional<float> exposure_stops;   // log2 of the factor on radiosity; none: automatic
  std::optional<Sun> sun;                // these three: over the camera file's, over the defaults
  std::optional<runtime::Sky> sky;
  float lights = 1;                      // factor on the lights of the file; 0: none
  bool lamps_only = false;               // neither sun nor sky
  int iterations = 8;                    // a frame
  int settle = 4000;  // at most, more of them before a picture: until light changes by less than 1e-6
  uint32_t samples = 2;                  // per pixel and axis
  bool compare = true;                   // full-world solve and difference pictures
};

// Writes NAME_0000_direct.png, _bounce.png, _difference.png, ... and figures.json into out_folder (made if missing),
// and returns what figures.json holds. `say` gets lines of progress. With device.validate, any message of the layers is
// an error. Each frame says whether its light settled, and what the last iteration changed. Errors: kIo, kInvalidFile,
// kUsage.
Result<nlohmann::json> run(const RunOptions& options, const std::function<void(const std::string&)>& say);

// What is wrong with the pictures and what to do about it, from what run() returned: nothing shines, or light had not settled and by how
// much; empty: nothing.
std::string warningOf(const nlohmann::json& figures);

}  // namespace ff::view
