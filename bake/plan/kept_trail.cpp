#include "bake/plan/kept_trail.h"

#include <algorithm>
#include <bit>
#include <map>
#include <span>
#include <utility>

#include "bake/packing.h"

namespace ff::bake {
namespace {

using formats::ByteReader, formats::ByteWriter;

constexpr int kDense = 32;  // cubes of a block: then all of them are taken for passed, which takes less room

void putDigest(ByteWriter& out, const Digest& d) { out.u64(d[0]), out.u64(d[1]); }

Digest seenNow(const Contents& contents, const KeptTrail& trail) {
  std::vector<Digest> all;
  for (const auto& [block, cubes] : trail.passed) contents.append(trail.box.cube(64 * block), cubes, uint64_t{64} * block, all);
  for (const uint64_t key : trail.met) all.push_back(contents.patchesIn(key));
  return digestOf(std::as_bytes(std::span(all)));
}

void putBox(ByteWriter& out, const CubeBox& box) {
  out.f32(box.edge_m);
  for (const auto* corner : {&box.lo, &box.size})
    for (const int32_t x : *corner) out.u32(static_cast<uint32_t>(x));
}

CubeBox takeBox(ByteReader& in) {
  CubeBox box;
  in.f32(box.edge_m);
  for (auto* corner : {&box.lo, &box.size})
    for (int32_t& x : *corner) {
      uint32_t value = 0;
      in.u32(value);
      x = static_cast<int32_t>(value);
    }
  return box;
}

void sortUnique(std::vector<uint64_t>& keys) {
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
}

void setSeen(KeptTrail& trail, const Contents& contents) {
  for (CubesOfBlock& of : trail.passed) if (std::popcount(of.cubes) >= kDense) of.cubes = ~uint64_t{0};
  trail.seen = seenNow(contents, trail);
}

// met: of all trails.
void putTrail(ByteWriter& out, const KeptTrail& trail, std::span<const uint64_t> met) {
  putDigest(out, trail.seen);
  putBox(out, trail.box);
  out.u8(trail.left.bits());
  putVarint(out, trail.passed.size());
  uint32_t last = 0;
  for (const CubesOfBlock& of : trail.passed) {
    putVarint(out, of.block - last);
    last = of.block;
  }
  for (const CubesOfBlock& of : trail.passed) out.u64(of.cubes);
  putVarint(out, trail.met.size());
  size_t at = 0, last_at = 0;
  for (const uint64_t key : trail.met) {
    while (met[at] != key) ++at;
    putVarint(out, at - last_at);
    last_at = at;
  }
}

bool takeTrail(ByteReader& in, std::span<const uint64_t> met, KeptTrail& trail) {
  in.u64(trail.seen[0]);
  in.u64(trail.seen[1]);
  trail.box = takeBox(in);
  uint8_t left = 0;
  in.u8(left);
  if (left > Sides::kAll) return false;
  trail.left = Sides(left);
  for (const int32_t x : trail.box.size) if (x < 1 || x % CubeBox::kBlock != 0) return false;
  uint64_t block = 0;
  for (uint64_t left_over = takeVarint(in); left_over > 0 && in.ok(); --left_over) {
    block += takeVarint(in);
    if (block >= trail.box.blocks()) return false;
    trail.passed.push_back({static_cast<uint32_t>(block), 0});
  }
  for (CubesOfBlock& of : trail.passed) in.u64(of.cubes);
  uint64_t at = 0;
  for (uint64_t left_over = takeVarint(in); left_over > 0 && in.ok(); --left_over) {
    at += takeVarint(in);
    if (at >= met.size()) return false;
    trail.met.push_back(met[at]);
  }
  return in.ok();
}

}  // namespace

KeptTrail keptTrail(const RayTrail& rays, const HitRows& rows, const PatchSet& set, const Contents& contents) {
  KeptTrail trail{.box = contents.box(), .left = rays.left(), .passed = rays.passed(), .met = {}};
  for (const uint32_t j : rows.column) {
    const uint64_t key = hilbertAncestor(set.patches[j].key, kMetLog);
    if (trail.met.empty() || trail.met.back() != key) trail.met.push_back(key);
  }
  sortUnique(trail.met);
  setSeen(trail, contents);
  return trail;
}

KeptTrail keptBeyond(const KeptTrail& rows, const RayTrail& rays, const KeptTrail* more, const Contents& contents) {
  KeptTrail trail{.box = contents.box(), .left = rays.left(), .passed = {}, .met = {}};
  std::map<uint32_t, uint64_t> cubes;  // by block
  for (const CubesOfBlock& of : rays.passed()) cubes[of.block] |= of.cubes;
  if (rows.box == trail.box)
    for (const CubesOfBlock& of : rows.passed)
      if (const auto found = cubes.find(of.block); found != cubes.end()) found->second &= ~of.cubes;
  if (more) {
    trail.left = Sides(trail.left.bits() | more->left.bits());
    for (const CubesOfBlock& of : more->passed) cubes[of.block] |= of.cubes;
  }
  for (const auto& [block, of] : cubes)
    if (of != 0) trail.passed.push_back({block, of});
  setSeen(trail, contents);
  return trail;
}

void putTrails(ByteWriter& out, std::span<const KeptTrail* const> trails) {
  std::vector<uint64_t> met;
  for (const KeptTrail* trail : trails) met.insert(met.end(), trail->met.begin(), trail->met.end());
  sortUnique(met);
  putVarint(out, met.size());
  uint64_t last = 0;
  for (const uint64_t key : met) {
    putVarint(out, key - last);
    last = key;
  }
  for (const KeptTrail* trail : trails) putTrail(out, *trail, met);
}

std::vector<KeptTrail> takeTrails(ByteReader& in, size_t trails) {
  std::vector<uint64_t> met;
  uint64_t key = 0;
  for (uint64_t left_over = takeVarint(in); left_over > 0 && in.ok(); --left_over) met.push_back(key += takeVarint(in));
  std::vector<KeptTrail> taken(trails);
  for (KeptTrail& trail : taken) if (!takeTrail(in, met, trail)) return {};
  return taken;
}

// What stands outside of the box now was not there when they left it; they went on by the sides that they left it by.
bool isAsItWas(const KeptTrail& trail, const Contents& contents) {
  const CubeBox& now = contents.box();
  if (trail.box.edge_m != now.edge_m) return false;
  for (size_t a = 0; a < 3; ++a) {
    if (trail.left.has(a, false) && now.lo[a] < trail.box.lo[a]) return false;
    if (trail.left.has(a, true) && now.lo[a] + now.size[a] > trail.box.lo[a] + trail.box.size[a]) return false;
  }
  return seenNow(contents, trail) == trail.seen;
}

}  // namespace ff::bake
