#include "bake/plan/contents.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <map>

#include "formats/codec/bytes.h"
#include "formats/codec/checksum.h"

namespace ff::bake {
namespace {

using formats::ByteWriter;

// A cube holds what comes so near it, in cells: rounding must not make a ray meet what stands beside the cubes that it passed through. Or so
// many units in the last place of the largest coordinate, where that is more.
constexpr double kMarginCells = 1.0 / 64, kMarginUnits = 8;
constexpr int32_t kAirCubes = 4;      // around the scene
constexpr int32_t kRoundCubes = 16;   // the box's corners are multiples: a small edit does not move them
static_assert(kRoundCubes % CubeBox::kBlock == 0);

uint64_t imageDigest(const Scene& scene, uint32_t image) {
  if (image == kNone) return 0;
  const Image& i = scene.images[image];
  ByteWriter b;
  b.u32(i.width);
  b.u32(i.height);
  b.u64(formats::hashBytes(std::as_bytes(std::span(i.rgba))));
  return formats::hashBytes(b.data());
}

}  // namespace

Contents::Contents(const Scene& scene, const PatchSet& set) : scene_(scene), set_(set) {
  Box bounds;
  for (const Triangle& t : scene.triangles)
    for (const uint32_t v : t.v) bounds.add(scene.positions[v]);
  for (int log = kCubeLog;; ++log) {
    box_.edge_m = set.cell_m * static_cast<float>(1 << log);
    for (int a = 0; a < 3; ++a) {
      const auto i = static_cast<size_t>(a);
      const auto cubeAt = [&](float x) { return static_cast<int32_t>(std::floor(static_cast<double>(x) / static_cast<double>(box_.edge_m))); };
      const auto roundDown = [](int32_t x) { return x & ~(kRoundCubes - 1); };
      box_.lo[i] = roundDown(cubeAt(bounds.lo[a]) - kAirCubes);
      box_.size[i] = roundDown(cubeAt(bounds.hi[a]) + kAirCubes + kRoundCubes) - box_.lo[i];
    }
    if (static_cast<double>(box_.size[0]) * box_.size[1] * box_.size[2] <= kMaxCubes) break;
  }
  for (const Material& m : scene.materials) material_.push_back(materialDigest(m));
  triangle_.resize(scene.triangles.size());
  tbb::parallel_for(size_t{0}, triangle_.size(), [&](size_t t) { triangle_[t] = triangleDigest(static_cast<uint32_t>(t)); });
  addPieces();

  ByteWriter names;
  for (uint32_t p = 0; p < set.patches.size();) {
    const uint64_t cube = hilbertAncestor(set.patches[p].key, kMetLog);
    const uint32_t first = p;
    names.data().clear();
    for (; p < set.patches.size() && hilbertAncestor(set.patches[p].key, kMetLog) == cube; ++p) {
      const Patch& patch = set.patches[p];
      names.u64(patch.name);
      names.u32(patch.orientation);
      for (const PatchTriangle& t : std::span(set.triangles).subspan(patch.first_triangle, patch.triangles))
        for (const Vec3& v : {t.a, t.b, t.c}) names.vec3(v);
    }
    patches_.push_back({cube, first, p, digestOf(names.data())});
  }
}

uint64_t Contents::materialDigest(const Material& m) const {
  ByteWriter b;
  for (const float x : {m.alpha, m.alpha_cutoff, m.transmission}) b.f32(x);
  for (const bool is : {m.repeat, m.double_sided, m.cutout, m.blend, m.occlude_only}) b.u8(is);
  b.u64(imageDigest(scene_, m.cutout ? m.base_image : kNone));
  return formats::hashBytes(b.data());
}

uint64_t Contents::triangleDigest(uint32_t t) const {
  const Triangle& triangle = scene_.triangles[t];
  const Material& m = scene_.materials[triangle.material];
  ByteWriter b;
  b.u64(material_[triangle.material]);
  const auto add = [&](Vec2 uv) { b.f32(uv.x), b.f32(uv.y); };
  for (const uint32_t v : triangle.v) {
    b.vec3(scene_.positions[v]);
    if (m.cutout && !scene_.uv0.empty()) add(scene_.uv0[v]);
    if (m.cutout && !scene_.colors.empty()) b.f32(scene_.colors[v].a);
  }
  return formats::hashBytes(b.data());
}

void Contents::addPieces() {
  struct Held {
    uint32_t cube, cut;  // cuts are by triangle: those of a cube keep their order
    uint64_t digest;
  };
  double largest = 0;
  for (const Vec3& p : scene_.positions)
    for (int a = 0; a < 3; ++a) largest = std::max(largest, static_cast<double>(std::abs(p[a])));
  const auto margin = static_cast<float>(std::max(kMarginCells * static_cast<double>(set_.cell_m), kMarginUnits * 0x1p-24 * largest));
  PagedVector<Held> held;
  uint32_t number = 0;
  // What a ray finds on a side of a piece, but for which patch: keptTrail() has the patches that are met.
  const auto finds = [](uint32_t patch) { return patch == kNone || patch == kSealed ? patch : 0; };
  set_.eachCut([&](uint32_t triangle, const Box& cell_box, const auto& pieces, const auto& outline) {
    ByteWriter b;
    b.u64(triangle_[triangle]);
    for (const int32_t x : pieces.front().cell) b.u32(static_cast<uint32_t>(x));
    const bool alike = std::ranges::all_of(pieces, [&](const auto& piece) { return std::ranges::equal(piece.patch, pieces.front().patch, {}, finds, finds); });
    for (const auto& piece : alike ? pieces.first(1) : pieces) {  // so that it does not count where others cut it
      for (const uint32_t patch : piece.patch) b.u32(finds(patch));
      if (!alike)
        for (const auto& side : outline(piece))
          for (const Point& p : {side.at, side.inward}) b.f64(p.x), b.f64(p.y), b.f64(p.z);
    }
    const uint64_t digest = formats::hashBytes(b.data());
    Box box;
    for (const uint32_t v : scene_.triangles[triangle].v) box.add(scene_.positions[v]);
    box = {max(box.lo, cell_box.lo), min(box.hi, cell_box.hi)};
    CubeBox::Cube lo, hi;
    for (int a = 0; a < 3; ++a) {
      const auto cubeAt = [&](float x) { return static_cast<int32_t>(std::floor(x / box_.edge_m)); };
      lo[static_cast<size_t>(a)] = cubeAt(std::min(box.lo[a], box.hi[a]) - margin);
      hi[static_cast<size_t>(a)] = cubeAt(std::max(box.lo[a], box.hi[a]) + margin);
    }
    for (int32_t x = lo[0]; x <= hi[0]; ++x)
      for (int32_t y = lo[1]; y <= hi[1]; ++y)
        for (int32_t z = lo[2]; z <= hi[2]; ++z)
          if (box_.holds({x, y, z})) held.push_back({box_.number({x, y, z}), number, digest});
    ++number;
  });
  tbb::parallel_sort(held.begin(), held.end(), [](const Held& a, const Held& b) { return std::pair(a.cube, a.cut) < std::pair(b.cube, b.cut); });
  ByteWriter of_cube;
  for (size_t i = 0; i < held.size();) {
    const uint32_t cube = held[i].cube;
    of_cube.data().clear();
    for (; i < held.size() && held[i].cube == cube; ++i) of_cube.u64(held[i].digest);
    Block& block = blocks_[cube / 64];
    if (block.held == 0) block.first = held_.size();
    block.held |= uint64_t{1} << cube % 64;
    held_.push_back(formats::hashBytes(of_cube.data()));
  }
}

uint64_t Contents::blockDigest(const Block& block) const {
  ByteWriter b;
  b.u64(block.held);
  for (size_t i = 0; i < static_cast<size_t>(std::popcount(block.held)); ++i) b.u64(held_[block.first + i]);
  return formats::hashBytes(b.data());
}

void Contents::append(const CubeBox::Cube& block, uint64_t cubes, uint64_t place, std::vector<Digest>& held) const {
  if (!box_.holds(block)) return;
  const auto found = blocks_.find(box_.number(block) / 64);
  if (found == blocks_.end()) return;
  for (uint64_t left = found->second.held & cubes; left != 0; left &= left - 1) {
    const auto bit = static_cast<uint64_t>(std::countr_zero(left));
    const auto before = static_cast<size_t>(std::popcount(found->second.held & ((uint64_t{1} << bit) - 1)));
    held.push_back({place + bit, held_[found->second.first + before]});
  }
}

const Contents::Range* Contents::find(uint64_t key) const {
  const auto found = std::lower_bound(patches_.begin(), patches_.end(), key, [](const Range& r, uint64_t k) { return r.key < k; });
  return found == patches_.end() || found->key != key ? nullptr : &*found;
}

Digest Contents::patchesIn(uint64_t key) const {
  const Range* range = find(key);
  return range ? range->digest : Digest{};
}

std::vector<std::byte> Contents::encoded() const {
  ByteWriter out;
  out.f32(box_.edge_m);
  for (const auto& [number, block] : std::map(blocks_.begin(), blocks_.end())) {
    for (const int32_t x : box_.cube(64 * number)) out.u32(static_cast<uint32_t>(x));
    out.u64(blockDigest(block));
  }
  return std::move(out.data());
}

std::vector<Vec3> Contents::changesSince(std::span<const std::byte> before) const {
  formats::ByteReader in(before);
  float edge_m = 0;
  in.f32(edge_m);
  if (edge_m != box_.edge_m) return {};
  std::map<CubeBox::Cube, uint64_t> changed;  // by the first cube of a block: digests that are in one of the two
  for (const auto& [number, block] : blocks_) changed[box_.cube(64 * number)] = blockDigest(block);
  while (in.remaining() >= 20) {
    CubeBox::Cube cube;
    for (int32_t& x : cube) {
      uint32_t value = 0;
      in.u32(value);
      x = static_cast<int32_t>(value);
    }
    uint64_t digest = 0;
    in.u64(digest);
    if (const auto now = changed.find(cube); now != changed.end() && now->second == digest) changed.erase(now);
    else changed[cube] = digest;
  }
  std::vector<Vec3> middles;
  for (const auto& [cube, digest] : changed) {
    Vec3 middle;
    for (int a = 0; a < 3; ++a) middle[a] = (static_cast<float>(cube[static_cast<size_t>(a)]) + 0.5f * CubeBox::kBlock) * edge_m;
    middles.push_back(middle);
  }
  return middles;
}

std::pair<uint32_t, uint32_t> Contents::rangeOf(uint64_t key) const {
  const Range* range = find(key);
  return range ? std::pair(range->first, range->end) : std::pair(0u, 0u);
}

Digest Contents::surface(uint32_t first, uint32_t end) const {
  ByteWriter b;
  for (uint32_t p = first; p < end; ++p) {
    const Patch& patch = set_.patches[p];
    b.u64(patch.name);
    b.u64(patch.key);
    for (const Vec3& v : {patch.centroid, patch.normal, patch.bounds.lo, patch.bounds.hi}) b.vec3(v);
    b.u32(patch.triangles);
    for (const PatchTriangle& t : std::span(set_.triangles).subspan(patch.first_triangle, patch.triangles)) {
      for (const Vec3& v : {t.a, t.b, t.c}) b.vec3(v);
      b.f32(t.cumulative_area);
      b.u64(triangle_[t.source]);
    }
  }
  return digestOf(b.data());
}

}  // namespace ff::bake
