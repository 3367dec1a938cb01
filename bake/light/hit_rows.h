// Where patches' rays ended: what casting makes and pooling takes.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "bake/light/lamp_light.h"
#include "bake/light/leaks.h"
#include "bake/light/sky_light.h"
#include "formats/codec/bytes.h"

namespace ff::bake {

inline constexpr double kRayParts = 256;

// Sparse rows of hit counts over patches; columns ascending. Rows sum with sky, absorbed and buried to their `rays`.
struct HitRows {
  std::vector<uint32_t> rays;      // per patch
  std::vector<uint64_t> start;     // patches + 1
  std::vector<uint32_t> column;
  std::vector<uint16_t> count;
  std::vector<uint32_t> estimate;  // what the rays of an entry stand for where geometry tells (unoccluded.h), in 1 / kRayParts of one; 0: the count
  std::vector<uint8_t> whole;      // of an estimate: nothing is hidden of the patch, as far as rays tell
  std::vector<uint32_t> sky, absorbed, buried;  // per patch; absorbed: back faces seen from exposed origins
  std::vector<float> square_error;       // per patch: RowError::square()
  std::vector<float> sky_fraction;       // per patch, of its whole area's hemispheres: with guided rays, where they were cast
  std::vector<SkyMeans> sky_means;       // per patch
  std::vector<std::vector<LampIrradiance>> lamps;  // per patch, by group
  std::vector<uint8_t> narrow;           // per patch: how many of kNarrowCells most rays do not get to
  std::vector<Leak> leaks;               // of all patches together

  size_t patches() const { return rays.size(); }
};

// Of the patch's area. A patch that is all buried keeps a token share: it has a row (all absorbed), and nothing sees it.
inline float exposedFraction(uint32_t buried, uint32_t rays) {
  return std::max(1e-6f, 1 - static_cast<float>(buried) / static_cast<float>(rays));
}

inline float exposedFraction(const HitRows& rows, size_t patch) { return exposedFraction(rows.buried[patch], rows.rays[patch]); }

// Rows of ranges that follow each other as those of one.
HitRows joined(std::vector<HitRows> ranges);

// Of a reader or a writer alike.
template <class Bytes, class Means>
void skyFields(Bytes& b, Means& means) {
  b.vec3(means.direction);
  for (auto& x : means.quadratic) b.f32(x);
}
void putLamps(formats::ByteWriter& out, std::span<const LampIrradiance> lamps);
std::vector<LampIrradiance> takeLamps(formats::ByteReader& in);

// Count, estimate and `whole` of an entry; taken ones are appended.
void putHits(formats::ByteWriter& out, const HitRows& rows, uint64_t entry);
void takeHits(formats::ByteReader& in, HitRows& rows);

// All but where rays hit (start, column, count, estimate and whole).
void putSeen(formats::ByteWriter& out, const HitRows& rows);
// raw: what `in` reads. False where it is not what putSeen() writes.
bool takeSeen(formats::ByteReader& in, std::span<const std::byte> raw, HitRows& rows);

// All of it, and back.
std::vector<std::byte> encoded(const HitRows& rows);
HitRows decodedHits(std::span<const std::byte> bytes);

// By patch, once its hits are put aside.
struct PatchSight {
  uint16_t rays = 0, absorbed = 0, buried = 0;
  uint8_t narrow = 0;       // HitRows::narrow
  float lamp_light = 0;     // that arrives directly, W/m2, mean of the colours
  float sky_fraction = 0, square_error = 0;

  float exposed() const { return exposedFraction(buried, rays); }
};
PatchSight sightOf(const HitRows& rows, size_t patch);

}  // namespace ff::bake
