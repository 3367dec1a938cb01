// What ffview draws: the patches of a world and the triangles that cover them. The drawing part of a world is read
// whole; only the light is streamed.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "formats/read/whole_world.h"


namespace ff::view {

struct ViewScene {
  std::vector<formats::Node> patches;    // level 0, by node number
  std::vector<Vec3> lamps;               // irradiance from the lamps as baked, W/m2, likewise
  std::vector<Vec3> corners;             // 3 per triangle, m, counter-clockwise from the front
  std::vector<uint32_t> triangle_patch;  // node number
  std::vector<uint32_t> sealed;          // triangles, ascending: no part of their patch but of the sealed surface that it goes on in
  float cell_m = 1;
  Box bounds;

  size_t triangles() const { return triangle_patch.size(); }
  std::vector<bool> whichAreSealed() const {  // by triangle
    std::vector<bool> which(triangles());
    for (const uint32_t t : sealed) which[t] = true;
    return which;
  }
};

// Errors: unreadable strips or geometry; a world that was baked without drawing geometry.
Result<ViewScene> loadScene(const formats::WholeWorld& world);

// Which patches light a drawing vertex; weights sum to 1, unused entries have weight 0.
struct VertexPatches {
  std::array<uint32_t, 8> patch{};
  std::array<float, 8> weight{};
};

// Compressed lists of sorted, unique numbers.
struct Lists {
  std::vector<uint32_t> start{0}, items;
  std::span<const uint32_t> of(uint32_t i) const { return {items.data() + start[i], items.data() + start[i + 1]}; }
};
Lists makeLists(std::vector<std::pair<uint32_t, uint32_t>> owner_and_item, size_t owners);

// The corners of the triangles, welded: one vertex for all corners at one place whose faces point within 60 degrees of
// each other, and that no wall between them parts (walls.h). Light is interpolated between such vertices; it never crosses
// from one surface to another that does not touch it, so it cannot leak through a thin wall or under one. Sealed triangles, which
// go on under walls, have vertices of their own with the light of their patch.
struct Weld {
  std::vector<uint32_t> corner_vertex;    // per corner
  std::vector<Vec3> position;             // per vertex; one place has one position, so that there are no cracks
  std::vector<Vec3> normal;               // per vertex, area-weighted mean of its faces
  std::vector<VertexPatches> light_from;  // per vertex
  Lists neighbours;                       // of a patch: those that it shares vertices with, which no wall parts from it
};

// A vertex takes light from the patches that meet in it and from those that touch these and face the same way (within 60
// degrees), by area times a tent of 1.5 cells of its grid around the patch's centroid; the 8 largest weights are kept.
Weld weldScene(const ViewScene& scene);

}  // namespace ff::view
