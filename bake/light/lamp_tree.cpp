#include "bake/light/lamp_tree.h"

#include <algorithm>
#include <cmath>

#include "bake/rays/cosine_rays.h"

namespace ff::bake {
namespace {

constexpr float kSmall = 0.35f;  // radius over distance: from there on a branch is sampled as one

float luminanceOf(Vec3 c) { return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z; }  // Rec. ITU-R BT.709

float sineOf(float cosine) { return std::sqrt(std::max(0.0f, 1 - cosine * cosine)); }

// Of the angle less another one, at least 0.
float cosineLess(float cosine, float less) {
  return cosine >= less ? 1.0f : cosine * less + sineOf(cosine) * sineOf(less);
}
// Of the sum of both angles, at most 180 degrees.
float cosineMore(float cosine, float more) {
  if (cosine <= -more) return -1;
  return cosine * more - sineOf(cosine) * sineOf(more);
}

Cone joined(const Cone& a, const Cone& b) {
  const Vec3 axis = normalized(a.axis + b.axis);
  if (axis == Vec3{} || a.cosine <= -1 || b.cosine <= -1) return {{0, 1, 0}, -1};
  return {axis, std::min(cosineMore(std::min(1.0f, dot(axis, a.axis)), a.cosine),
                         cosineMore(std::min(1.0f, dot(axis, b.axis)), b.cosine))};
}

float areaOf(const PatchTriangle& t) { return 0.5f * length(cross(t.b - t.a, t.c - t.a)); }

}  // namespace

Cone coneOf(std::span<const PatchTriangle> triangles) {
  Vec3 sum;
  for (const PatchTriangle& t : triangles) sum += cross(t.b - t.a, t.c - t.a);
  Cone cone{normalized(sum), 1};
  if (cone.axis == Vec3{}) return {{0, 1, 0}, -1};
  for (const PatchTriangle& t : triangles)
    if (const Vec3 n = normalized(cross(t.b - t.a, t.c - t.a)); !(n == Vec3{})) cone.cosine = std::min(cone.cosine, dot(cone.axis, n));
  return cone;
}

Receiver receiverOf(const PatchSet& set, uint32_t patch) {
  const Patch& p = set.patches[patch];
  return {(p.bounds.lo + p.bounds.hi) * 0.5f, 0.5f * length(p.bounds.hi - p.bounds.lo),
          coneOf({set.triangles.data() + p.first_triangle, p.triangles})};
}

LampTree::LampTree(const Scene& scene, const PatchSet& set, const RayCaster& caster) : scene_(scene), set_(set), caster_(caster), leaf_of_(set.patches.size(), kNone) {
  PagedVector<uint32_t> emitters;
  for (uint32_t p = 0; p < set.patches.size(); ++p)
    if (set.patches[p].emits() && luminanceOf(set.patches[p].emission) > 0) emitters.push_back(p);
  if (emitters.empty()) return;
  nodes_.reserve(2 * emitters.size());
  leaf_node_.reserve(emitters.size());
  power_before_.reserve(emitters.size() + 1);
  build(emitters, kNone);  // patches are sorted by Hilbert key: halves are compact
}

uint32_t LampTree::build(std::span<const uint32_t> emitters, uint32_t parent) {
  const auto at = static_cast<uint32_t>(nodes_.size());
  Node& node = nodes_.emplace_back();
  node.parent = parent;
  node.first_leaf = static_cast<uint32_t>(leaf_node_.size());
  if (emitters.size() == 1) {
    leaf_of_[emitters[0]] = at;
    const Patch& p = set_.patches[emitters[0]];
    node.emission = p.emission;
    node.group = p.lamp_group;
    node.first = static_cast<uint32_t>(triangles_.size());
    node.triangles = p.triangles;
    node.bounds = p.bounds;
    node.normals = coneOf({set_.triangles.data() + p.first_triangle, p.triangles});
    for (const PatchTriangle& t : std::span(set_.triangles).subspan(p.first_triangle, p.triangles)) {
      node.area_m2 += areaOf(t);
      triangles_.push_back({t.a, t.b, t.c, normalized(cross(t.b - t.a, t.c - t.a)), node.area_m2, t.source, caster_.surfaceOffset(t.source), scene_.materials[scene_.triangles[t.source].material].cutout});
    }
    node.area_m2 = std::max(node.area_m2, 1e-30f);
    node.power = node.area_m2 * luminanceOf(p.emission);
    leaf_node_.push_back(at);
    power_before_.push_back(power_before_.back() + static_cast<double>(node.power));
    node.end_leaf = static_cast<uint32_t>(leaf_node_.size());
    return at;
  }
  const uint32_t left = build(emitters.first(emitters.size() / 2), at);
  const uint32_t right = build(emitters.subspan(emitters.size() / 2), at);
  Node& whole = nodes_[at];  // `node` may have moved
  const Node &a = nodes_[left], &b = nodes_[right];
  whole.left = left;
  whole.right = right;
  whole.bounds.add(a.bounds);
  whole.bounds.add(b.bounds);
  whole.normals = joined(a.normals, b.normals);
  whole.power = a.power + b.power;
  whole.end_leaf = b.end_leaf;
  return at;
}

float LampTree::importance(const Receiver& receiver, const Node& node, bool* small) const {
  const Vec3 way = (node.bounds.lo + node.bounds.hi) * 0.5f - receiver.centre;
  const float own = 0.5f * length(node.bounds.hi - node.bounds.lo), radius = own + receiver.radius_m;
  const float distance = length(way);
  *small = own < kSmall * distance;
  if (distance <= radius) return node.power / std::max(radius * radius, 1e-20f);
  const float spread = std::sqrt(1 - radius / distance * (radius / distance));  // cosine of what the spheres span
  const Vec3 to = way / distance;
  const float arriving = cosineLess(cosineLess(dot(receiver.normals.axis, to), receiver.normals.cosine), spread);
  const float leaving = cosineLess(cosineLess(-dot(node.normals.axis, to), node.normals.cosine), spread);
  if (arriving <= 0 || leaving <= 0) return 0;
  return node.power * arriving * leaving / (distance * distance);
}

void LampTree::aimsOf(const Receiver& receiver, std::vector<Aim>& aims) const {
  aims.clear();
  if (empty()) return;
  std::vector<uint32_t> open{0};
  while (!open.empty()) {
    const uint32_t at = open.back();
    open.pop_back();
    const Node& node = nodes_[at];
    bool small = false;
    const float importance = this->importance(receiver, node, &small);
    if (!(importance > 0)) continue;
    if (small || node.isLeaf()) {
      aims.push_back({at, importance});
    } else {
      open.push_back(node.right);
      open.push_back(node.left);
    }
  }
}

LampTree::Choice LampTree::choose(uint32_t node, double u) const {
  const auto before = power_before_.begin() + nodes_[node].first_leaf, end = power_before_.begin() + nodes_[node].end_leaf;
  const double x = *before + u * (*end - *before);
  const auto above = std::upper_bound(before + 1, end, x);  // at the leaf's end
  const uint32_t leaf = leaf_node_[static_cast<size_t>(above - power_before_.begin()) - 1];
  const auto* const of = reinterpret_cast<const char*>(&nodes_[leaf]);
  __builtin_prefetch(of);
  __builtin_prefetch(of + sizeof(Node) - 1);
  return {leaf, std::clamp((x - above[-1]) / (*above - above[-1]), 0.0, 0x1.fffffep-1)};
}

LampTree::Point LampTree::point(const Choice& choice, float v, float w) const {
  const Node& of = nodes_[choice.leaf];
  const auto m2 = static_cast<float>(choice.share * static_cast<double>(of.area_m2));
  const auto first = triangles_.begin() + of.first, last = first + of.triangles;
  const LampTriangle& t = *std::min(std::upper_bound(first, last, m2, [](float m, const LampTriangle& triangle) { return m < triangle.cumulative_m2; }), last - 1);
  return {pointInTriangle(t.a, t.b, t.c, v, w), t.normal, choice.leaf, t.source, t.offset_m, t.cutout};
}

}  // namespace ff::bake
