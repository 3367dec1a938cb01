// One frame, top to bottom: stream -> cut -> local matrix -> light that arrives without a bounce -> k iterations of the solver.
#pragma once
#include <chrono>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <tuple>
#include <vector>

#include "runtime/cut/cut_builder.h"
#include "runtime/cut/cut_fade.h"
#include "runtime/entering_light.h"
#include "runtime/lamps.h"
#include "runtime/sky.h"
#include "runtime/solver/converge.h"
#include "runtime/solver/solver.h"
#include "stream/streamer.h"

namespace ff::runtime {

// Direct irradiance (sun, the caller's own lamps; neither the sky nor what surfaces emit) of the nodes of one tile, W/m2, one per node; for a
// cluster the area-weighted mean over its patches. Called on the frame thread when a tile enters the cut and after
// Updater::lightChanged(). Null: no direct light. What is no light (sound_light.h) is taken for zero, and counted.
using DirectLight = std::function<void(formats::TileId, std::span<Vec3> out)>;

struct FrameStats {
  uint32_t slots = 0, leaves = 0, level0_leaves = 0;
  uint64_t entries = 0;
  bool matrix_changed = false;
  uint32_t applied_tiles = 0;  // that entered the matrix in this frame
  uint32_t waiting_tiles = 0;  // that are there and wait for their turn to enter
  uint32_t light_zeroed =
      0;  // values of DirectLight, and sources made of them, that were no light and were taken for zero
  UploadedBytes uploaded;  // since the start
  double stream_ms = 0, matrix_ms = 0, solve_ms = 0;  // solve_ms: on the clock of the device that made the steps
  double steps_ms = 0;                                // that the frame's thread spent on them, or on recording them
};

// What to add to a place of one world to have it in the coordinates of another, m.
Vec3 originStep(const formats::WorldInfo& from, const formats::WorldInfo& to);

class Updater {
 public:
  // All three must outlive the updater. background: the matrix of a new cut is put together on a thread of its own and taken up a frame or two later,
  // whole; else within the frame. fade: over how many frames light follows a change of the cut (cut_fade.h, Solver::ease); by default at
  // once. Tiles are then wanted so much earlier, by the time that frames take. max_applied_tiles: that enter in a frame, at most (cut_budget.h); 0: no limit. A frame that waits
  // (awaitCut), the first one, and one that gives out all slots anew, for want of consecutive ones, take all. now: the time that frames are taken to begin at.
  Updater(const formats::World& world, stream::Streamer& streamer, Solver& solver,
          FarLight far_light = FarLight::kPyramid, bool background = false, const FadeSettings& fade = {}, uint32_t max_applied_tiles = 0,
          stream::Now now = std::chrono::steady_clock::now);
  // These four refuse what is no light (sound_light.h), with its place, and leave all as it was.
  Result<void> setSky(const Sky& sky);
  // From the next frame on, a lamp group (below lamps().groups()) emits `scale` times what was baked, at every level of the cut.
  // Costs a pass over the active nodes and their lamps; 1, 1, 1 brings the same bits back.
  Result<void> setLamp(uint32_t group, Vec3 scale);
  const Lamps& lamps() const { return lamps_; }
  // Radiosity of all that is far, but for what it emits, W/m2; FarLight::kConstant only.
  Result<void> setAmbient(Vec3 radiosity);
  void setDirectLight(DirectLight direct);
  void lightChanged();
  // Sets direct irradiance by slot, W/m2, from the next frame on, until DirectLight is asked again or the tile leaves.
  // Slots beyond the matrix are left out.
  Result<void> setDirectIrradiance(uint32_t first_slot, std::span<const Vec3> irradiance);

  // k for `gather`: two; one where no light has changed for 60 frames, and nobody has jumped.
  static constexpr int kAsLightNeeds = -1;
  // Runs one frame. iterations: k. Radiosity carries over from the last frame by node, so light lags by at most a few
  // frames after a change of the cut. An error of the solver stays until it goes: what the solver has not taken up it is told again, with every frame
  // that comes, as a matrix that is new to it. Light is then that of the last frame before, where it could be had.
  Result<FrameStats> frame(const stream::Observers& observers, int iterations);
  Result<FrameStats> frame(Vec3 observer, Vec3 velocity, int iterations) { return frame(stream::Observers(stream::Observer{observer, velocity}), iterations); }
  // These two are for a re-bake of a world that is shown (reload.h), before the first frame. prepare(): on any thread; puts together the matrix of the
  // streamer's active tiles, and what goOnFrom() needs to know of the world shown until now.
  Result<void> prepare(const formats::WorldInfo& before);
  // Takes the place of an updater with the same solver, which is not used any more: goes on with its direct light, its sky, its switches of lamps (by their
  // groups' names; new ones are as baked), and with what its nodes reflect, where there is one of the same name in the same place. Others start from
  // their nearest ancestor that has, else with the mean irradiance of all. Allocates nothing.
  void goOnFrom(Updater& before);
  // Whether the solver has what the last frame brought; else it may still look at what an updater before has.
  bool isTakenUp() const { return started_ && !missed_; }
  // The next frame waits until the matrix is that of the streamer's active tiles, and light need not follow any more.
  void awaitCut() { await_cut_ = true; }
  // Until one step more changes no channel by more than `tolerance` times the largest radiosity, or max_iterations.
  Result<Settled> converge(float tolerance, int max_iterations);

  const LocalMatrix& matrix() const;  // of the last frame
  // By number in LocalMatrix::tiles.
  const stream::ResidentStrip& strip(size_t tile) const { return cut_.strip(tile); }
  void renumberNext() { cut_.renumberNext(); }  // these two are for tests
  void awaitBuild() const { cut_.await(); }     // what is put together in the background is ready for the next frame
  // What the solver was told of the matrix, by the last frame that says matrix_changed.
  const MatrixChange& change() const { return *told_; }
  // Per slot, W/m2, rgb and 0:
  std::span<const Vec4> source() const { return source_; }      // albedo * what arrives without a bounce: the solver's source
  std::span<const Vec4> emission() const { return emission_; }  // what the slot's surface emits now
  uint64_t emissionChange() const { return emission_change_; }  // one more whenever emission() is another
  // Whether that was the last time because tiles entered and left, as change() says, and for no other slot.
  bool emissionEntered() const { return emission_entered_; }
  Result<void> reflected(std::span<Vec4> out) { return solver_.radiosity(out); }  // R, after any number of bounces
  std::span<const Vec4> reflectedInMemory() { return solver_.inMemory(); }         // likewise; Solver::inMemory()
  Result<void> radiosity(std::span<Vec4> out);                  // B: show() of R
  // Makes what slots show of what they reflect: blended where tiles leave (cut_fade.h), and what they emit added.
  void show(std::span<Vec4> reflected) const;
  const CutFade& fade() const { return fade_; }
  const stream::Lead& lead() const { return lead_; }  // that the last frame asked of the streamer
  // The last number that was taken for zero, as a line; empty: none. Its memory is taken when there is one.
  const std::string& lightFault() const { return light_fault_; }

 private:
  Result<bool> followCut();
  Result<void> askForCut(bool whole);
  Result<void> takeUpChange(bool whole);
  void lightEntered(std::span<const uint32_t> entered);
  Result<void> tellSolver(const MatrixChange& change, bool goes_on);
  const MatrixChange& wholeMatrix();
  void takeLight(Updater& before);
  void light(uint32_t tile, bool ask_direct_light, bool ask_lamps);
  bool relit() const { return sky_changed_ || light_changed_ || lamps_changed_; }  // all sources are to be made anew
  bool isLight(uint32_t slot, const char* what, Vec3 value);
  std::string nameOf(uint32_t slot) const;
  Result<void> relightAll();

  const formats::World& world_;
  stream::Streamer& streamer_;
  Solver& solver_;
  const stream::Now now_;
  Sky sky_;
  Lamps lamps_;
  DirectLight direct_light_;
  EnteringLight entering_;
  CutFade fade_;
  CutBuilder cut_;
  Vec3 ambient_;
  stream::Observers observers_;
  std::vector<Vec4> source_, emission_;   // per slot; of free slots emission_ is 0
  std::vector<uint8_t> emits_;            // by a tile's first slot: emission_ of its slots may be other than 0
  std::vector<Vec3> direct_irradiance_;   // per slot, W/m2
  bool has_direct_ = false;               // it may be other than 0
  std::vector<Vec3> lamp_irradiance_;     // likewise
  std::vector<Vec4> radiosity_, before_;  // per slot; of takeUpChange(), scratch of converge()
  std::vector<SlotRange> tiles_before_;   // of the matrix that was taken up last
  FrameStats counts_;  // of the matrix
  uint64_t emission_change_ = 0;
  bool emission_entered_ = false;
  std::chrono::steady_clock::time_point frame_began_;
  float frame_seconds_ = 0;
  stream::Lead lead_;
  bool await_cut_ = false, jumped_ = false;  // for the next followCut()
  uint32_t rested_frames_ = 0;               // since light has changed, or somebody has jumped
  uint32_t frames_since_jump_ = 0;           // of an observer
  bool missed_ = false;  // the solver has not taken up the last change: before_ is the light to go on from, by slot
  // Of prepare().
  struct Named {
    uint32_t level;
    formats::TileName name;
    uint32_t tile;  // number in LocalMatrix::tiles
    auto key() const { return std::tuple(level, name.chunk, name.tile); }
  };
  std::vector<Named> names_;           // by key()
  std::vector<uint32_t> lamp_before_;  // by lamp group: the one of its name in the world before, kNoLampGroup: none
  Vec3 from_before_;                   // between the two worlds' origins, m
  MatrixChange whole_;
  const MatrixChange* told_ = &whole_;
  bool started_ = false, sky_changed_ = false, light_changed_ = false, lamps_changed_ = false;
  uint32_t light_zeroed_ = 0, applied_tiles_ = 0;  // in this frame
  std::string light_fault_;
};

}  // namespace ff::runtime
