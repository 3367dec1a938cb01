// A binary tree over the emitters of a scene: which of them may light a place, and how much at most.
// Alejandro Conty Estevez, Christopher Kulla. Importance sampling of many lights with adaptive tree splitting. 2018.
#pragma once
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

  // set outlives the tree.
  explicit LampTree(const PatchSet& set);
  bool empty() const { return nodes_.empty(); }
  size_t nodes() const { return nodes_.size(); }
  // Replaces `aims` by branches that are small from where the receiver is, and together hold every emitter that could light
  // it: what is left out lies behind it or turns its back.
  void aimsOf(const Receiver& receiver, std::vector<Aim>& aims) const;

  // The leaf of an emitting patch; kNone for others.
  uint32_t leafOf(uint32_t patch) const { return leaf_of_[patch]; }
  uint32_t parent(uint32_t node) const { return nodes_[node].parent; }  // kNone: the root
  float power(uint32_t node) const { return nodes_[node].power; }       // area times luminance; > 0

  struct Point {
    Vec3 position, normal;
    uint32_t patch = 0, triangle = 0;  // of the scene
  };
  // A point of the branch, emitters by power, points uniformly over their area. u: chooses; v, w: place. All in [0, 1).
  Point point(uint32_t node, float u, float v, float w) const;
  // How densely point() of a branch falls on a patch in it, 1/m2.
  double density(uint32_t node, uint32_t patch) const {
    const Node& leaf = nodes_[leaf_of_[patch]];
    return static_cast<double>(leaf.power) / static_cast<double>(nodes_[node].power) / static_cast<double>(leaf.area_m2);
  }

 private:
  struct Node {
    Box bounds;
    Cone normals;
    float power = 0, area_m2 = 0;  // area: of leaves, holes included
    float left_share = 0;          // of the power
    uint32_t parent = kNone, left = 0, right = 0;
    uint32_t patch = kNone;        // of a leaf
  };
  uint32_t build(std::span<const uint32_t> emitters, uint32_t parent);
  float importance(const Receiver& receiver, const Node& node, bool* small) const;

  const PatchSet& set_;
  std::vector<Node> nodes_;
  std::vector<uint32_t> leaf_of_;
  std::vector<float> cumulative_m2_;  // by triangle of the set, within its patch; of emitters only
};

}  // namespace ff::bake
