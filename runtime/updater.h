// One frame, top to bottom: stream -> cut -> local matrix -> source light -> k iterations of the solver.
#pragma once
#include <functional>
#include <memory>
#include <span>

#include "runtime/matrix_assembler.h"
#include "runtime/solver.h"
#include "stream/streamer.h"

namespace ff::runtime {

// A sky of radiance L(w) = l0 + dot(l1, w) per channel, W/(m2 sr). l1[c] is the gradient of channel c.
struct Sky {
  Vec3 l0;
  Vec3 l1[3];
};

// Irradiance of a node from the sky, W/m2.
Vec3 skyIrradiance(const Sky& sky, const formats::Node& node);

// Direct irradiance (sun, spot lamps; not the sky, not emission) of the nodes of one tile, W/m2, one per node; for a
// cluster the area-weighted mean over its patches. Called on the frame thread when a tile enters the cut and after
// Updater::lightChanged(). Null: no direct light.
using DirectLight = std::function<void(formats::TileId, std::span<Vec3> out)>;

struct FrameStats {
  uint32_t slots = 0, leaves = 0, level0_leaves = 0;
  uint64_t entries = 0;
  bool matrix_changed = false;
  double stream_ms = 0, matrix_ms = 0, solve_ms = 0;
};

class Updater {
 public:
  // All three must outlive the updater.
  Updater(const formats::World& world, stream::Streamer& streamer, Solver& solver,
          FarLight far_light = FarLight::kPyramid);
  void setSky(const Sky& sky);
  // Radiosity of all that is far, W/m2; FarLight::kConstant only.
  void setAmbient(Vec3 radiosity);
  void setDirectLight(DirectLight direct);
  void lightChanged();
  // Sets direct irradiance by slot, W/m2, from the next frame on, until DirectLight is asked again or the tile leaves.
  // Slots beyond the matrix are left out.
  void setDirectIrradiance(uint32_t first_slot, std::span<const Vec3> irradiance);

  // Runs one frame. iterations: k. Radiosity carries over from the last frame by node, so light lags by at most a few
  // frames after a change of the cut.
  Result<FrameStats> frame(Vec3 observer, Vec3 velocity, int iterations);
  // Iterates until the largest change of any channel is below `tolerance` times the largest radiosity, or
  // max_iterations.
  Result<int> converge(float tolerance, int max_iterations);

  const LocalMatrix& matrix() const;  // of the last frame
  const MatrixAssembler& assembler() const { return assembler_; }
  std::span<const Vec4> source() const;  // M per slot, W/m2
  std::span<const Vec4> direct() const;  // emission + albedo * direct irradiance (no sky, no bounces), W/m2
  Result<void> radiosity(std::span<Vec4> out);

 private:
  Result<void> takeUpChange();
  void light(uint32_t tile, bool ask_direct_light);
  Result<void> relightAll();

  const formats::World& world_;
  stream::Streamer& streamer_;
  Solver& solver_;
  Sky sky_;
  DirectLight direct_light_;
  MatrixAssembler assembler_;
  Vec3 ambient_;
  std::vector<Vec4> source_, direct_;     // per slot
  std::vector<Vec3> direct_irradiance_;   // per slot, W/m2
  std::vector<Vec4> radiosity_, before_;  // per slot; scratch of takeUpChange() and converge()
  std::vector<SlotRange> tiles_before_;
  FrameStats counts_;  // of the matrix
  bool started_ = false, sky_changed_ = false, light_changed_ = false;
};

}  // namespace ff::runtime
