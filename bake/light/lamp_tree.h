// A binary tree over the emitters of a scene: which of them may light a place, and how much at most.
// Alejandro Conty Estevez, Christopher Kulla. Importance sampling of many lights with adaptive tree splitting. 2018.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/surface/patches.h"

namespace ff::bake {

// All directions within an angle of `axis`.
struct Cone {
  Vec3 axis;
  float cosine = 1;  // of the angle; -1: all directions
};
Cone coneOf(std::span<const PatchTriangle> triangles);  // of their normals

// Where light arrives: a sphere around a patch, and the patch's normals.
struct Receiver {
  Vec3 centre;
  float radius_m = 0;
  Cone normals;
};
Receiver receiverOf(const PatchSet& set, uint32_t patch);

class LampTree {
 public:
  // A branch that is sampled as one.
  struct Aim {
    uint32_t node;
    float importance;  // > 0; about the irradiance that it would give unhindered
  };

  // Places anywhere look at it, whatever lies between: what it says of lamps is held in memory, some 300 bytes a patch that emits. set outlives the tree.
  LampTree(const Scene& scene, const PatchSet& set, const RayCaster& caster);
  bool empty() const { return nodes_.empty(); }
  size_t nodes() const { return nodes_.size(); }
  // Replaces `aims` by branches that are small from where the receiver is, and together hold every emitter that could light
  // it: what is left out lies behind it or turns its back.
  void aimsOf(const Receiver& receiver, std::vector<Aim>& aims) const;

  // The leaf of an emitting patch; kNone for others.
  uint32_t leafOf(uint32_t patch) const { return leaf_of_[patch]; }
  uint32_t parent(uint32_t node) const { return nodes_[node].parent; }  // kNone: the root
  bool isLeaf(uint32_t node) const { return nodes_[node].isLeaf(); }
  std::array<uint32_t, 2> children(uint32_t node) const { return {nodes_[node].left, nodes_[node].right}; }  // of no leaf; larger numbers than its own
  float power(uint32_t node) const { return nodes_[node].power; }       // area times luminance; > 0

  struct Point {
    Vec3 position, normal;
    uint32_t leaf = 0, triangle = 0;  // triangle: of the scene
    float offset_m = 0;               // RayCaster::surfaceOffset()
    bool cutout = false;              // of its material
  };
  struct Choice {
    uint32_t leaf;
    double share;  // of its area: which of its triangles
  };
  // A point of a branch, emitters by power, points uniformly over their area. u: chooses; v, w: place. All in [0, 1). Leaves lie far apart in memory: who chooses many makes
  // a step for all of them before the next, so that what one waits for comes while the others are chosen.
  Choice choose(uint32_t node, double u) const;
  void fetch(const Choice& choice) const { __builtin_prefetch(&triangles_[nodes_[choice.leaf].first]); }
  Point point(const Choice& choice, float v, float w) const;
  // How densely points of a branch fall on the patch of a leaf in it, 1/m2.
  double density(uint32_t node, uint32_t leaf) const {
    return static_cast<double>(nodes_[leaf].power) / static_cast<double>(nodes_[node].power) / static_cast<double>(nodes_[leaf].area_m2);
  }
  // Of a leaf's patch.
  Vec3 emission(uint32_t leaf) const { return nodes_[leaf].emission; }
  uint16_t group(uint32_t leaf) const { return nodes_[leaf].group; }

 private:
  struct Node {
    Box bounds;
    Cone normals;
    float power = 0, area_m2 = 0;  // area: of leaves, holes included
    uint32_t first_leaf = 0, end_leaf = 0;  // in the order of leaves
    uint32_t parent = kNone, left = 0, right = 0;
    uint32_t first = kNone, triangles = 0;  // of a leaf: in triangles_
    Vec3 emission;                 // of a leaf, as its group
    uint16_t group = formats::kNoLampGroup;
    bool isLeaf() const { return first != kNone; }
  };
  struct LampTriangle {
    Vec3 a, b, c, normal;
    float cumulative_m2;  // within the patch, up to and including this one
    uint32_t source;      // triangle of the scene
    float offset_m;
    bool cutout;
  };
  uint32_t build(std::span<const uint32_t> emitters, uint32_t parent);
  float importance(const Receiver& receiver, const Node& node, bool* small) const;

  const Scene& scene_;
  const PatchSet& set_;
  const RayCaster& caster_;
  std::vector<Node> nodes_;
  std::vector<LampTriangle> triangles_;  // by leaf
  // In the order of leaves. A branch's leaves follow each other, so that one is found among numbers that lie close together, not by a way down the tree.
  std::vector<double> power_before_{0};  // of the leaves before; one more for the end
  std::vector<uint32_t> leaf_node_;
  PagedVector<uint32_t> leaf_of_;
};

}  // namespace ff::bake
