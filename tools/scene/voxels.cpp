#include "tools/scene/voxels.h"

#include <algorithm>
#include <map>
#include <string>
#include <unordered_map>

namespace ff::tools {

uint64_t Voxels::exposedFaces() const {
  uint64_t n = 0;
  for (int y = 0; y < size_.y; ++y)
    for (int z = 0; z < size_.z; ++z)
      for (int x = 0; x < size_.x; ++x) {
        if (kind_[index({x, y, z})] == kAir) continue;
        for (const Int3& normal : kFaceNormals) n += air(Int3{x, y, z} + normal) ? 1 : 0;
      }
  return n;
}

uint64_t Voxels::count(std::span<const uint8_t> kinds) const {
  return static_cast<uint64_t>(std::ranges::count_if(
      kind_, [&](uint8_t k) { return std::ranges::find(kinds, k) != kinds.end(); }));
}

namespace {

int& axisOf(Int3& p, int axis) { return axis == 0 ? p.x : axis == 1 ? p.y : p.z; }

// One chunk's parts while they grow; a corner of a part is one vertex.
class ChunkMesh {
 public:
  ChunkMesh(Int3 lo, Int3 origin) : lo_(lo), origin_(origin) {}

  // The rectangle at voxel p that spans `across` voxels along axis u and `along` along axis v, on the side of `normal`.
  void rectangle(uint8_t kind, Int3 p, int normal, int u, int v, int across, int along) {
    Part& part = parts_[kind];
    const int n_axis = normal / 2;
    if (normal % 2 == 1) axisOf(p, n_axis) += 1;
    std::array<Int3, 4> corner{p, p, p, p};
    axisOf(corner[1], u) += across;
    axisOf(corner[2], u) += across;
    axisOf(corner[2], v) += along;
    axisOf(corner[3], v) += along;
    std::array<uint32_t, 4> id{};
    for (size_t i = 0; i < 4; ++i) id[i] = vertex(part, corner[i]);
    // u x v points along +n for the axes (n, n+1, n+2) taken cyclically.
    if (normal % 2 == 1)
      part.mesh.indices.insert(part.mesh.indices.end(), {id[0], id[1], id[2], id[0], id[2], id[3]});
    else
      part.mesh.indices.insert(part.mesh.indices.end(), {id[0], id[2], id[1], id[0], id[3], id[2]});
  }

  std::vector<ScenePart> take() {
    std::vector<ScenePart> out;
    for (auto& [kind, part] : parts_) {
      part.mesh.material = kind - 1u;
      out.push_back(std::move(part.mesh));
    }
    return out;
  }

 private:
  struct Part {
    ScenePart mesh;
    std::unordered_map<uint32_t, uint32_t> vertex_of_corner;
  };

  uint32_t vertex(Part& part, Int3 c) {
    const auto key = static_cast<uint32_t>(((c.y - lo_.y) << 20) | ((c.z - lo_.z) << 10) | (c.x - lo_.x));
    const auto [it, is_new] = part.vertex_of_corner.try_emplace(key, static_cast<uint32_t>(part.mesh.positions.size()));
    if (is_new) {
      const Int3 w = c + origin_;
      part.mesh.positions.push_back({static_cast<float>(w.x), static_cast<float>(w.y), static_cast<float>(w.z)});
    }
    return it->second;
  }

  Int3 lo_, origin_;
  std::map<uint8_t, Part> parts_;
};

// The exposed faces of one slice of a chunk as a grid of kinds, emitted as rectangles row by row.
void emitSlice(ChunkMesh& mesh, std::vector<uint8_t>& face, Int3 start, int normal, int nu, int nv, bool merge) {
  const int u = (normal / 2 + 1) % 3, v = (normal / 2 + 2) % 3;
  const auto at = [&](int i, int j) -> uint8_t& { return face[static_cast<size_t>(j * nu + i)]; };
  for (int j = 0; j < nv; ++j)
    for (int i = 0; i < nu; ++i) {
      const uint8_t kind = at(i, j);
      if (kind == Voxels::kAir) continue;
      int across = 1, along = 1;
      if (merge) {
        while (i + across < nu && at(i + across, j) == kind) ++across;
        const auto row_matches = [&](int row) {
          for (int k = i; k < i + across; ++k)
            if (at(k, row) != kind) return false;
          return true;
        };
        while (j + along < nv && row_matches(j + along)) ++along;
      }
      for (int b = j; b < j + along; ++b)
        for (int a = i; a < i + across; ++a) at(a, b) = Voxels::kAir;
      Int3 p = start;
      axisOf(p, u) += i;
      axisOf(p, v) += j;
      mesh.rectangle(kind, p, normal, u, v, across, along);
    }
}

}  // namespace

std::vector<SceneNode> meshVoxels(const Voxels& voxels, const VoxelMeshOptions& options) {
  std::vector<SceneNode> nodes;
  const Int3 size = voxels.size();
  const int edge = std::clamp(options.chunk, 1, 512);
  std::vector<uint8_t> face;
  for (int cy = 0; cy < size.y; cy += edge)
    for (int cz = 0; cz < size.z; cz += edge)
      for (int cx = 0; cx < size.x; cx += edge) {
        Int3 lo{cx, cy, cz};
        Int3 extent{std::min(edge, size.x - cx), std::min(edge, size.y - cy), std::min(edge, size.z - cz)};
        ChunkMesh mesh(lo, options.origin);
        for (int normal = 0; normal < 6; ++normal) {
          const int n = normal / 2, u = (n + 1) % 3, v = (n + 2) % 3;
          const int nu = axisOf(extent, u), nv = axisOf(extent, v);
          for (int slice = 0; slice < axisOf(extent, n); ++slice) {
            Int3 start = lo;
            axisOf(start, n) += slice;
            face.assign(static_cast<size_t>(nu * nv), Voxels::kAir);
            for (int j = 0; j < nv; ++j)
              for (int i = 0; i < nu; ++i) {
                Int3 p = start;
                axisOf(p, u) += i;
                axisOf(p, v) += j;
                if (!voxels.air(p) && voxels.air(p + kFaceNormals[static_cast<size_t>(normal)]))
                  face[static_cast<size_t>(j * nu + i)] = voxels.at(p);
              }
            emitSlice(mesh, face, start, normal, nu, nv, options.merge);
          }
        }
        std::vector<ScenePart> parts = mesh.take();
        if (parts.empty()) continue;
        nodes.push_back({"chunk " + std::to_string(cx / edge) + " " + std::to_string(cy / edge) + " " +
                             std::to_string(cz / edge),
                         std::move(parts)});
      }
  return nodes;
}

}  // namespace ff::tools
