#include "tools/view/light.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "formats/read/whole_world.h"

namespace ff::view {

using runtime::kNoSlot;
using runtime::LocalMatrix;
using runtime::Vec4;

namespace {

constexpr uint32_t kNone = 0xffffffffu;
constexpr float kSameWay = 0.5f;  // cosine: within 60 degrees
constexpr float kTentSides = 1.5f;

// Patches of one slot that hang together.
struct Piece {
  uint32_t slot = 0;
  Vec3 centroid, normal;
  float side_m = 0;  // the longest one of its box
  float filled = 0;  // its share of a square of that side: crumbs and rims weigh little
};

struct Pieces {
  std::vector<Piece> piece;
  std::vector<uint32_t> of_patch;
};

Pieces piecesOf(const ViewScene& scene, const Lists& neighbours, std::span<const uint32_t> patch_slot) {
  Pieces p;
  p.of_patch.assign(scene.patches.size(), kNone);
  std::vector<uint32_t> open;
  for (uint32_t first = 0; first < scene.patches.size(); ++first) {
    if (p.of_patch[first] != kNone) continue;
    const auto number = static_cast<uint32_t>(p.piece.size());
    Piece piece;
    piece.slot = patch_slot[first];
    float area_m2 = 0;
    Box box;
    p.of_patch[first] = number;
    open.push_back(first);
    while (!open.empty()) {
      const uint32_t patch = open.back();
      open.pop_back();
      const formats::Node& n = scene.patches[patch];
      area_m2 += n.area_m2;
      piece.centroid += n.centroid * n.area_m2;
      piece.normal += n.normal * n.area_m2;
      const Vec3 half = Vec3{1, 1, 1} * (0.5f * std::sqrt(n.area_m2));
      box.add(n.centroid - half);
      box.add(n.centroid + half);
      for (const uint32_t other : neighbours.of(patch))
        if (p.of_patch[other] == kNone && patch_slot[other] == piece.slot) {
          p.of_patch[other] = number;
          open.push_back(other);
        }
    }
    if (area_m2 > 0) piece.centroid = piece.centroid / area_m2;
    piece.normal = normalized(piece.normal);
    const Vec3 size = box.hi - box.lo;
    piece.side_m = std::max({size.x, size.y, size.z});
    if (piece.side_m > 0) piece.filled = area_m2 / (piece.side_m * piece.side_m);
    p.piece.push_back(piece);
  }
  return p;
}

// The ratio of the darker to the brighter.
float likeness(const shaders::vec4& a, const shaders::vec4& b) {
  const float sum_a = a.x + a.y + a.z, sum_b = b.x + b.y + b.z, brighter = std::max(sum_a, sum_b);
  return brighter > 0 ? std::min(sum_a, sum_b) / brighter : 1;
}

}  // namespace

std::vector<uint32_t> patchSlots(const formats::WholeWorld& world, const LocalMatrix& matrix) {
  std::vector<uint32_t> slots(world.levels()[0].nodes);
  for (const formats::TileInfo& info : world.tiles(0)) {
    const formats::TileRef tile = world.ref(info.id);
    for (uint32_t i = 0; i < info.nodes; ++i) {
      uint32_t& slot = slots[info.first_node + i];
      slot = runtime::slotFor(matrix.tiles, tile, i);
      FF_CHECK_LT(slot, matrix.slots());  // the coarsest level is always active
    }
  }
  return slots;
}

std::vector<shaders::vec4> gatherLight(const LocalMatrix& m, std::span<const Vec4> reflected) {
  std::vector<shaders::vec4> light(m.slots());
  for (uint32_t s = 0; s < m.slots(); ++s) {
    Vec3 sum;
    for (const uint32_t entry : m.row(s)) {
      const Vec4& r = reflected[runtime::slotOfEntry(entry)];
      sum += static_cast<float>(runtime::countOfEntry(entry)) * Vec3{r.x, r.y, r.z};
    }
    sum *= m.row_scale[s];
    light[s] = {sum.x, sum.y, sum.z, 0};
  }
  for (const LocalMatrix::Refined& r : m.refined) {
    Vec3 sum;
    float area = 0;
    m.forEachChild(r, [&](uint32_t c) {
      sum += m.area_m2[c] * Vec3{light[c].x, light[c].y, light[c].z};
      area += m.area_m2[c];
    });
    if (!(area > 0)) continue;
    sum = sum / area;
    light[r.slot] = {sum.x, sum.y, sum.z, 0};
  }
  return light;
}

std::vector<shaders::vec4> patchLight(const ViewScene& scene, const Lists& neighbours, std::span<const uint32_t> patch_slot,
                                      std::span<const shaders::vec4> slots) {
  std::vector<uint32_t> patches_of(slots.size());
  for (const uint32_t slot : patch_slot) ++patches_of[slot];
  const Pieces pieces = piecesOf(scene, neighbours, patch_slot);
  std::vector<std::pair<uint32_t, uint32_t>> pairs;  // a cluster's piece, and itself or one that touches it
  for (uint32_t p = 0; p < patch_slot.size(); ++p) {
    if (patches_of[patch_slot[p]] < 2) continue;
    pairs.emplace_back(pieces.of_patch[p], pieces.of_patch[p]);
    for (const uint32_t other : neighbours.of(p)) pairs.emplace_back(pieces.of_patch[p], pieces.of_patch[other]);
  }
  const Lists around = makeLists(std::move(pairs), pieces.piece.size());

  std::vector<shaders::vec4> light(patch_slot.size());
  for (uint32_t p = 0; p < patch_slot.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    const shaders::vec4 own = slots[patch_slot[p]];
    Vec3 sum;
    float weights = 0;
    for (const uint32_t number : around.of(pieces.of_patch[p])) {
      const Piece& piece = pieces.piece[number];
      const shaders::vec4 e = slots[piece.slot];
      const float tent = 1 - length(n.centroid - piece.centroid) / (kTentSides * piece.side_m);
      if (!(tent > 0) || (number != pieces.of_patch[p] && dot(piece.normal, n.normal) <= kSameWay)) continue;
      const float weight = tent * piece.filled * likeness(e, own);
      sum += weight * Vec3{e.x, e.y, e.z};
      weights += weight;
    }
    light[p] = weights > 0 ? shaders::vec4{sum.x / weights, sum.y / weights, sum.z / weights, 0} : own;
  }
  return light;
}

std::vector<double> patchSource(const ViewScene& scene, std::span<const float> sun_exposure, const Sun& sun,
                                const runtime::Sky& sky) {
  std::vector<double> source;
  source.reserve(3 * scene.patches.size());
  for (size_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    const Vec3 m = n.albedo * (sun_exposure[p] * sun.irradiance + scene.lamps[p] + skyIrradiance(sky, n));
    for (int c = 0; c < 3; ++c) source.push_back(static_cast<double>(m[c]));
  }
  return source;
}

Comparison compare(const ViewScene& scene, const LocalMatrix& matrix, std::span<const uint32_t> patch_slot,
                   std::span<const shaders::vec4> light, std::span<const double> full, std::span<const double> source,
                   Vec3 eye, float inner_m) {
  double mean = 0, area = 0;
  for (size_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    double square = 0;
    for (size_t c = 0; c < 3; ++c) square += full[3 * p + c] * full[3 * p + c];
    mean += static_cast<double>(n.area_m2) * std::sqrt(square);
    area += static_cast<double>(n.area_m2);
  }
  mean = area > 0 ? mean / area : 0;

  Comparison out;
  out.difference.resize(scene.patches.size());
  double error = 0, reflected = 0, bounced = 0;
  for (size_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    const shaders::vec4 e = light[patch_slot[p]];
    const float streamed[3] = {n.albedo.x * e.x, n.albedo.y * e.y, n.albedo.z * e.z};
    double square = 0, bounce_square = 0, reflected_square = 0;
    for (int c = 0; c < 3; ++c) {
      const size_t i = 3 * p + static_cast<size_t>(c);
      const double want = full[i] - source[i], all = full[i];
      const double d = static_cast<double>(streamed[c]) - want;
      square += d * d;
      bounce_square += want * want;
      reflected_square += all * all;
    }
    out.difference[p] = mean > 0 ? static_cast<float>(std::sqrt(square) / mean) : 0.0f;
    const uint32_t own = matrix.slotOf(0, static_cast<uint32_t>(p));
    if (own == kNoSlot || !matrix.leaf[own] || length(n.centroid - eye) > inner_m) continue;
    error += square;
    bounced += bounce_square;
    reflected += reflected_square;
    ++out.patches_compared;
  }
  out.reflected_error = reflected > 0 ? std::sqrt(error / reflected) : 0;
  out.bounced_error = bounced > 0 ? std::sqrt(error / bounced) : 0;
  return out;
}

}  // namespace ff::view
