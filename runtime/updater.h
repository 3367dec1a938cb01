// One frame, top to bottom: stream -> cut -> local matrix -> source light -> k iterations of the solver.
#pragma once
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "runtime/converge.h"
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
// Updater::lightChanged(). Null: no direct light. What is no light (sound_light.h) is taken for zero, and counted.
using DirectLight = std::function<void(formats::TileId, std::span<Vec3> out)>;

struct FrameStats {
  uint32_t slots = 0, leaves = 0, level0_leaves = 0;
  uint64_t entries = 0;
  bool matrix_changed = false;
  uint32_t light_zeroed =
      0;  // values of DirectLight, and sources made of them, that were no light and were taken for zero
  double stream_ms = 0, matrix_ms = 0, solve_ms = 0;
};

class Updater {
 public:
  // All three must outlive the updater.
  Updater(const formats::World& world, stream::Streamer& streamer, Solver& solver,
          FarLight far_light = FarLight::kPyramid);
  // These three refuse what is no light (sound_light.h), with its place, and leave all as it was.
  Result<void> setSky(const Sky& sky);
  // Radiosity of all that is far, W/m2; FarLight::kConstant only.
  Result<void> setAmbient(Vec3 radiosity);
  void setDirectLight(DirectLight direct);
  void lightChanged();
  // Sets direct irradiance by slot, W/m2, from the next frame on, until DirectLight is asked again or the tile leaves.
  // Slots beyond the matrix are left out.
  Result<void> setDirectIrradiance(uint32_t first_slot, std::span<const Vec3> irradiance);

  // Runs one frame. iterations: k. Radiosity carries over from the last frame by node, so light lags by at most a few
  // frames after a change of the cut.
  Result<FrameStats> frame(Vec3 observer, Vec3 velocity, int iterations);
  // Until one step more changes no channel by more than `tolerance` times the largest radiosity, or max_iterations.
  Result<Settled> converge(float tolerance, int max_iterations);

  const LocalMatrix& matrix() const;  // of the last frame
  const MatrixAssembler& assembler() const { return assembler_; }
  std::span<const Vec4> source() const;  // M per slot, W/m2
  std::span<const Vec4> direct() const;  // emission + albedo * direct irradiance (no sky, no bounces), W/m2
  Result<void> radiosity(std::span<Vec4> out);
  // The last number that was taken for zero, as a line; empty: none. Its memory is taken when there is one.
  const std::string& lightFault() const { return light_fault_; }

 private:
  Result<void> takeUpChange();
  void light(uint32_t tile, bool ask_direct_light);
  bool isLight(uint32_t slot, const char* what, Vec3 value);
  std::string nameOf(uint32_t slot) const;
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
  uint32_t light_zeroed_ = 0;  // in this frame
  std::string light_fault_;
};

}  // namespace ff::runtime
