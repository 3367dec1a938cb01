// Light between the solver's slots and the drawn patches.
#pragma once
#include <span>
#include <vector>

#include "formats/read/whole_world.h"
#include "runtime/updater.h"
#include "shaders/shared.h"
#include "stream/streamer.h"
#include "tools/view/renderer.h"
#include "tools/view/scene.h"

namespace ff::view {

// Slot of every patch, or of its nearest active ancestor.
std::vector<uint32_t> patchSlots(const formats::WholeWorld& world, const runtime::LocalMatrix& matrix);

// Irradiance of every slot from what surfaces reflect. Refined slots get the area-weighted means of their children.
// reflected: per slot, W/m2.
std::vector<shaders::vec4> gatherLight(const runtime::LocalMatrix& matrix, std::span<const runtime::Vec4> reflected);

// Irradiance of every patch from what surfaces reflect, for pictures: its slot's, and where a slot stands for several patches, smooth
// from cluster to cluster. The patches of a slot that hang together by `neighbours` (Weld's) are a piece. A patch takes the light of
// its own piece and of those that touch it and face as it does (within 60 degrees): by a tent around the piece's centroid of 1.5
// times its longest side, by how much of the square of that side it fills, and by how much its light is like the patch's own, darker
// over brighter, so that contrasts stay (Tomasi, Manduchi. Bilateral Filtering for Gray and Color Images. 1998). No light passes a
// wall, also where a cluster has patches on either side. slots: gatherLight().
std::vector<shaders::vec4> patchLight(const ViewScene& scene, const Lists& neighbours, std::span<const uint32_t> patch_slot,
                                      std::span<const shaders::vec4> slots);

// M per patch, 3 each: albedo * (sun + lamps + sky).
std::vector<double> patchSource(const ViewScene& scene, std::span<const float> sun_exposure, const Sun& sun,
                                const runtime::Sky& sky);

// The streamed light against the full-world solve.
struct Comparison {
  std::vector<float> difference;   // per patch: |streamed - full| bounced radiosity over the world's mean reflected one
  double reflected_error = 0;      // relative L2 of reflected radiosity over the active patches within `inner_m`
  double bounced_error = 0;        // likewise of what bounces alone put there
  uint32_t patches_compared = 0;
};
// full: what is reflected in the full solve, source: its M; both 3 per patch. light: gatherLight().
Comparison compare(const ViewScene& scene, const runtime::LocalMatrix& matrix, std::span<const uint32_t> patch_slot,
                   std::span<const shaders::vec4> light, std::span<const double> full, std::span<const double> source,
                   Vec3 eye, float inner_m);

}  // namespace ff::view
