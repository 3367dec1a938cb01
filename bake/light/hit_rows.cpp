#include "bake/light/hit_rows.h"

#include <iterator>
#include <utility>

#include "bake/memory.h"
#include "bake/packing.h"

namespace ff::bake {

HitRows joined(std::vector<HitRows> ranges) {
  size_t n = 0, entries = 0;
  for (const HitRows& r : ranges) {
    n += r.rays.size();
    entries += r.column.size();
  }
  HitRows all;
  const auto join = [&](auto member, size_t size) {
    auto& to = all.*member;
    to.reserve(size);
    for (HitRows& r : ranges) {
      auto& from = r.*member;
      to.insert(to.end(), std::make_move_iterator(from.begin()), std::make_move_iterator(from.end()));
      release(from);
    }
  };
  all.start.reserve(n + 1);
  all.start.push_back(0);
  for (HitRows& r : ranges) {
    const uint64_t before = all.start.back();
    for (size_t i = 1; i < r.start.size(); ++i) all.start.push_back(before + r.start[i]);
  }
  join(&HitRows::column, entries);
  join(&HitRows::count, entries);
  join(&HitRows::estimate, entries);
  join(&HitRows::whole, entries);
  for (const auto member : {&HitRows::rays, &HitRows::sky, &HitRows::absorbed, &HitRows::buried}) join(member, n);
  join(&HitRows::square_error, n);
  join(&HitRows::sky_fraction, n);
  join(&HitRows::sky_means, n);
  join(&HitRows::lamps, n);
  join(&HitRows::narrow, n);
  for (HitRows& r : ranges) all.leaks.insert(all.leaks.end(), r.leaks.begin(), r.leaks.end());
  return all;
}

void putLamps(formats::ByteWriter& out, std::span<const LampIrradiance> lamps) {
  putVarint(out, lamps.size());
  for (const LampIrradiance& lamp : lamps) {
    out.u16(lamp.group);
    for (const double x : lamp.rgb) out.f64(x);
  }
}

std::vector<LampIrradiance> takeLamps(formats::ByteReader& in) {
  std::vector<LampIrradiance> lamps;
  for (uint64_t left = takeVarint(in); left > 0 && in.ok(); --left) {
    LampIrradiance& lamp = lamps.emplace_back();
    in.u16(lamp.group);
    for (double& x : lamp.rgb) in.f64(x);
  }
  return lamps;
}

void putSeen(formats::ByteWriter& out, const HitRows& rows) {
  out.u32(static_cast<uint32_t>(rows.patches()));
  putValues(out, rows.rays);
  for (const auto* values : {&rows.sky, &rows.absorbed, &rows.buried}) putValues(out, *values);
  putValues(out, rows.square_error);
  putValues(out, rows.sky_fraction);
  putValues(out, rows.sky_means);
  putValues(out, rows.narrow);
  for (const auto& lamps : rows.lamps) putLamps(out, lamps);
  putVarint(out, rows.leaks.size());
  for (const Leak& leak : rows.leaks) {
    out.vec3(leak.at);
    out.f32(leak.m2);
  }
}

bool takeSeen(formats::ByteReader& in, std::span<const std::byte> raw, HitRows& rows) {
  uint32_t n = 0;
  in.u32(n);
  takeValues(in, raw, n, rows.rays);
  for (auto* values : {&rows.sky, &rows.absorbed, &rows.buried}) takeValues(in, raw, n, *values);
  takeValues(in, raw, n, rows.square_error);
  takeValues(in, raw, n, rows.sky_fraction);
  takeValues(in, raw, n, rows.sky_means);
  takeValues(in, raw, n, rows.narrow);
  if (!in.ok()) return false;
  rows.lamps.resize(n);
  for (auto& lamps : rows.lamps) lamps = takeLamps(in);
  for (uint64_t left = takeVarint(in); left > 0 && in.ok(); --left) {
    Leak& leak = rows.leaks.emplace_back();
    in.vec3(leak.at);
    in.f32(leak.m2);
  }
  return in.ok();
}

void putHits(formats::ByteWriter& out, const HitRows& rows, uint64_t entry) {
  const uint32_t estimate = rows.estimate[entry];
  putVarint(out, 4u * rows.count[entry] + 2u * rows.whole[entry] + (estimate > 0));
  if (estimate > 0) putVarint(out, estimate);
}

void takeHits(formats::ByteReader& in, HitRows& rows) {
  const uint64_t hits = takeVarint(in);
  rows.count.push_back(static_cast<uint16_t>(hits / 4));
  rows.whole.push_back(hits / 2 % 2);
  rows.estimate.push_back(hits % 2 > 0 ? static_cast<uint32_t>(takeVarint(in)) : 0);
}

std::vector<std::byte> encoded(const HitRows& rows) {
  formats::ByteWriter out;
  putSeen(out, rows);
  for (size_t i = 0; i < rows.patches(); ++i) {
    putVarint(out, rows.start[i + 1] - rows.start[i]);
    uint32_t last = 0;
    for (uint64_t k = rows.start[i]; k < rows.start[i + 1]; last = rows.column[k++]) {
      putVarint(out, rows.column[k] - last);
      putHits(out, rows, k);
    }
  }
  return std::move(out.data());
}

HitRows decodedHits(std::span<const std::byte> bytes) {
  formats::ByteReader in(bytes);
  HitRows rows;
  takeSeen(in, bytes, rows);
  rows.start.push_back(0);
  for (size_t i = 0; i < rows.patches(); ++i) {
    uint32_t last = 0;
    for (uint64_t left = takeVarint(in); left > 0; --left) {
      rows.column.push_back(last += static_cast<uint32_t>(takeVarint(in)));
      takeHits(in, rows);
    }
    rows.start.push_back(rows.column.size());
  }
  return rows;
}

PatchSight sightOf(const HitRows& rows, size_t patch) {
  double lamp_light = 0;
  for (const LampIrradiance& lamp : rows.lamps[patch]) lamp_light += (lamp.rgb[0] + lamp.rgb[1] + lamp.rgb[2]) / 3;
  return {.rays = static_cast<uint16_t>(rows.rays[patch]),
          .absorbed = static_cast<uint16_t>(rows.absorbed[patch]),
          .buried = static_cast<uint16_t>(rows.buried[patch]),
          .narrow = rows.narrow[patch],
          .lamp_light = static_cast<float>(lamp_light),
          .sky_fraction = rows.sky_fraction[patch],
          .square_error = rows.square_error[patch]};
}

}  // namespace ff::bake
