// What sky and lamps bring to the tiles that enter a cut, reckoned beside the cut's matrix, on the thread that puts that together: a frame copies it.
#pragma once
#include <cstdint>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

#include "runtime/cut/cut_builder.h"
#include "runtime/lamps.h"
#include "runtime/sky.h"

namespace ff::runtime {

// The frame's thread calls, but for build(). Takes memory on the builder's thread alone, past what tiles of most cuts need.
class EnteringLight final : public CutCompanion {
 public:
  EnteringLight();

  // From the next cut on that is begun.
  void set(const Sky& sky, const Lamps& lamps);

  // Of the nodes of MatrixChange::entered that was taken up last, tile after tile.
  struct Nodes {
    std::vector<Vec3> lamps;                // irradiance, W/m2
    std::vector<Vec4> emission, source;     // as Updater has them by slot; source: without direct light
    std::vector<uint8_t> emits;             // by tile: emission is other than 0 somewhere
    bool is_light = false;                  // all of it (sound_light.h)
    uint64_t number = 0;                    // of the sky and lamps that it is of
  };
  // Null: it is of other sky or lamps than set() has brought since.
  const Nodes* nodes() const { return taken_.number == number_ ? &taken_ : nullptr; }

  void build(const MatrixAssembler& cut) override;
  void take() override { std::swap(made_, taken_); }

 private:
  std::mutex mutex_;
  Sky sky_;
  Lamps lamps_;
  uint64_t number_ = 0;
  Nodes made_, taken_;  // made_: the builder's until take()
  // Copies of build().
  Sky sky_then_;
  Lamps lamps_then_;
};

// M, W/m2: what a node reflects of light that arrives without a bounce.
inline Vec3 reflectedSource(const formats::Node& node, const Sky& sky, Vec3 direct, Vec3 lamps) { return node.albedo * (direct + lamps + skyIrradiance(sky, node)); }

}  // namespace ff::runtime
