#include "bake/plan/contents.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <type_traits>

#include "bake/light/form_factor.h"
#include "formats/codec/bytes.h"

namespace ff::bake {
namespace {

// A cube holds what comes so near it, in cells: rounding must not make a ray meet what stands beside the cubes that it passed through. Or so
// many units in the last place of the largest coordinate, where that is more.
constexpr double kMarginCells = 1.0 / 64, kMarginUnits = 8;
constexpr int32_t kAirCubes = 1;      // around the scene
constexpr int32_t kRoundCubes = 4;    // the box's corners are multiples: a small edit does not move them

// Bytes to be hashed, one value after the other.
class Bytes {
 public:
  template <class T>
  Bytes& add(const T& value) {
    static_assert(std::has_unique_object_representations_v<T> || std::is_floating_point_v<T>);
    const auto* p = reinterpret_cast<const std::byte*>(&value);
    bytes_.insert(bytes_.end(), p, p + sizeof value);
    return *this;
  }
  Bytes& add(Vec3 v) { return add(v.x).add(v.y).add(v.z); }
  uint64_t short_digest() const { return XXH3_64bits(bytes_.data(), bytes_.size()); }
  Digest digest() const { return digestOf(bytes_); }
  void clear() { bytes_.clear(); }

 private:
  std::vector<std::byte> bytes_;
};

uint64_t imageDigest(const Scene& scene, uint32_t image) {
  if (image == kNone) return 0;
  const Image& i = scene.images[image];
  return XXH3_64bits_withSeed(i.rgba.data(), i.rgba.size(), uint64_t{i.width} << 32 | i.height);
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

  Bytes names, lamps;
  for (uint32_t p = 0; p < set.patches.size();) {
    const uint64_t cube = hilbertAncestor(set.patches[p].key, kCastLog);
    const uint32_t first = p;
    names.clear();
    for (; p < set.patches.size() && hilbertAncestor(set.patches[p].key, kCastLog) == cube; ++p) names.add(set.patches[p].name).add(set.patches[p].orientation);
    patches_[cube] = {first, p, names.digest()};
  }
  for (uint32_t p = 0; p < set.patches.size(); ++p)
    if (const Patch& patch = set.patches[p]; patch.emits()) lamps.add(surface(p, p + 1)).add(patch.emission).add(patch.lamp_group);
  lamps_ = lamps.digest();
}

uint64_t Contents::materialDigest(const Material& m) const {
  Bytes b;
  b.add(m.alpha).add(m.emission).add(m.alpha_cutoff).add(m.transmission);
  b.add(static_cast<uint8_t>(m.repeat | m.double_sided << 1 | m.cutout << 2 | m.blend << 3 | m.occlude_only << 4));
  b.add(imageDigest(scene_, m.cutout ? m.base_image : kNone)).add(imageDigest(scene_, m.emission_image));
  return b.short_digest();
}

uint64_t Contents::triangleDigest(uint32_t t) const {
  const Triangle& triangle = scene_.triangles[t];
  const Material& m = scene_.materials[triangle.material];
  Bytes b;
  b.add(material_[triangle.material]);
  for (const uint32_t v : triangle.v) {
    b.add(scene_.positions[v]);
    if (m.cutout && !scene_.uv0.empty()) b.add(scene_.uv0[v].x).add(scene_.uv0[v].y);
    if (m.cutout && !scene_.colors.empty()) b.add(scene_.colors[v].a);
    if (m.emission_image != kNone && !scene_.uv1.empty()) b.add(scene_.uv1[v].x).add(scene_.uv1[v].y);
  }
  return b.short_digest();
}

uint64_t Contents::patchName(uint32_t patch) const { return patch == kNone || patch == kSealed ? patch : set_.patches[patch].name; }

void Contents::addPieces() {
  struct Held {
    uint32_t cube, piece;  // pieces are by triangle: those of a cube keep their order
    uint64_t digest;
  };
  double largest = 0;
  for (const Vec3& p : scene_.positions)
    for (int a = 0; a < 3; ++a) largest = std::max(largest, static_cast<double>(std::abs(p[a])));
  const auto margin = static_cast<float>(std::max(kMarginCells * static_cast<double>(set_.cell_m), kMarginUnits * 0x1p-24 * largest));
  std::vector<Held> held;
  uint32_t number = 0;
  set_.eachPiece([&](uint32_t triangle, const Box& cell_box, const auto& piece, const auto& rims) {
    Bytes b;
    b.add(triangle_[triangle]).add(piece.cell).add(patchName(piece.patch[0])).add(patchName(piece.patch[1]));
    for (const auto& rim : rims)
      for (const Point& p : {rim.at, rim.inward}) b.add(p.x).add(p.y).add(p.z);
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
          if (box_.holds({x, y, z})) held.push_back({box_.number({x, y, z}), number, b.short_digest()});
    ++number;
  });
  tbb::parallel_sort(held.begin(), held.end(), [](const Held& a, const Held& b) { return std::pair(a.cube, a.piece) < std::pair(b.cube, b.piece); });
  Bytes of_cube;
  for (size_t i = 0; i < held.size();) {
    const uint32_t cube = held[i].cube;
    of_cube.clear();
    for (; i < held.size() && held[i].cube == cube; ++i) of_cube.add(held[i].digest);
    cube_[cube] = of_cube.digest();
  }
}

Digest Contents::cube(const CubeBox::Cube& cube) const {
  if (!box_.holds(cube)) return {};
  const auto found = cube_.find(box_.number(cube));
  return found == cube_.end() ? Digest{} : found->second;
}

Digest Contents::patchesIn(uint64_t cast_cube) const {
  const auto found = patches_.find(cast_cube);
  return found == patches_.end() ? Digest{} : found->second.digest;
}

std::vector<std::byte> Contents::encoded() const {
  formats::ByteWriter out;
  out.f32(box_.edge_m);
  for (const auto& [number, digest] : std::map(cube_.begin(), cube_.end())) {
    for (const int32_t x : box_.cube(number)) out.u32(static_cast<uint32_t>(x));
    out.u64(digest[0]);
  }
  return std::move(out.data());
}

std::vector<Vec3> Contents::changesSince(std::span<const std::byte> before) const {
  formats::ByteReader in(before);
  float edge_m = 0;
  in.f32(edge_m);
  if (edge_m != box_.edge_m) return {};
  std::map<CubeBox::Cube, uint64_t> changed;  // digests that are in one of the two
  for (const auto& [number, digest] : cube_) changed[box_.cube(number)] = digest[0];
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
    for (int a = 0; a < 3; ++a) middle[a] = (static_cast<float>(cube[static_cast<size_t>(a)]) + 0.5f) * edge_m;
    middles.push_back(middle);
  }
  return middles;
}

std::pair<uint32_t, uint32_t> Contents::rangeOf(uint64_t cast_cube) const {
  const auto found = patches_.find(cast_cube);
  return found == patches_.end() ? std::pair(0u, 0u) : std::pair(found->second.first, found->second.end);
}

Digest Contents::surface(uint32_t first, uint32_t end) const {
  Bytes b;
  for (uint32_t p = first; p < end; ++p) {
    const Patch& patch = set_.patches[p];
    b.add(patch.name).add(patch.key).add(patch.centroid).add(patch.normal).add(patch.bounds.lo).add(patch.bounds.hi).add(patch.triangles);
    for (const PatchTriangle& t : std::span(set_.triangles).subspan(patch.first_triangle, patch.triangles))
      b.add(t.a).add(t.b).add(t.c).add(t.cumulative_area).add(triangle_[t.source]);
  }
  return b.digest();
}

}  // namespace ff::bake
