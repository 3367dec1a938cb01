#include "bake/import/instances.h"

#include <cmath>

#include "bake/import/elements.h"

namespace ff::bake::gltf {
namespace {

// t: 3 numbers, q: unit quaternion x y z w, s: 3 numbers.
Matrix compose(const double* t, const double* q, const double* s) {
  const double x = q[0], y = q[1], z = q[2], w = q[3];
  return {s[0] * (1 - 2 * (y * y + z * z)),
          s[0] * (2 * (x * y + z * w)),
          s[0] * (2 * (x * z - y * w)),
          0,
          s[1] * (2 * (x * y - z * w)),
          s[1] * (1 - 2 * (x * x + z * z)),
          s[1] * (2 * (y * z + x * w)),
          0,
          s[2] * (2 * (x * z + y * w)),
          s[2] * (2 * (y * z - x * w)),
          s[2] * (1 - 2 * (x * x + y * y)),
          0,
          t[0],
          t[1],
          t[2],
          1};
}

Matrix localTransform(const tinygltf::Node& node) {
  if (!node.matrix.empty()) {
    Matrix m;
    std::copy(node.matrix.begin(), node.matrix.end(), m.begin());
    return m;
  }
  constexpr double kZero[3] = {0, 0, 0}, kOne[3] = {1, 1, 1}, kNoTurn[4] = {0, 0, 0, 1};
  return compose(node.translation.empty() ? kZero : node.translation.data(),
                 node.rotation.empty() ? kNoTurn : node.rotation.data(), node.scale.empty() ? kOne : node.scale.data());
}

// EXT_mesh_gpu_instancing: each instance's own transform comes before the node's.
void addGpuInstances(const Document& document, const tinygltf::Value& extension, const Instance& node,
                     std::vector<Instance>& out, Budget& budget) {
  const tinygltf::Value& attributes = extension.Get("attributes");
  const auto find = [&](const char* name) -> std::optional<Elements> {
    if (!attributes.Has(name)) return {};
    return Elements(document, attributes.Get(name).GetNumberAsInt());
  };
  const auto translation = find("TRANSLATION"), rotation = find("ROTATION"), scale = find("SCALE");
  const uint64_t count = translation ? translation->count() : rotation ? rotation->count() : scale->count();
  const std::string place = "node " + std::to_string(node.node);
  budget.take(count * 2 * sizeof(Instance), place);
  for (uint64_t i = 0; i < count; ++i) {
    double t[3] = {0, 0, 0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
    for (uint32_t c = 0; c < 3; ++c) {
      if (translation) t[c] = translation->value(i, c);
      if (scale) s[c] = scale->value(i, c);
    }
    if (rotation) {
      double squared = 0;
      for (uint32_t c = 0; c < 4; ++c) q[c] = rotation->value(i, c), squared += q[c] * q[c];
      if (!(std::fabs(squared - 1) < 0.1))  // 8-bit quaternions are this coarse
        refuse(place, "instance " + std::to_string(i) + " has no unit quaternion");
      for (double& c : q) c /= std::sqrt(squared);
    }
    out.push_back({multiply(node.to_world, compose(t, q, s)), node.node});
  }
}

}  // namespace

Matrix multiply(const Matrix& a, const Matrix& b) {
  Matrix out{};
  for (size_t c = 0; c < 4; ++c)
    for (size_t r = 0; r < 4; ++r)
      for (size_t k = 0; k < 4; ++k) out[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return out;
}

double determinant(const Matrix& m) {
  return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[4] * (m[1] * m[10] - m[2] * m[9]) + m[8] * (m[1] * m[6] - m[2] * m[5]);
}

Matrix transformOf(const Json& validated) {
  Matrix m;
  if (validated.contains("matrix")) {
    validated["matrix"].get_to(m);
    return m;
  }
  const auto of = [&](const char* key, std::vector<double> otherwise) { return validated.value(key, otherwise); };
  return compose(of("translation", {0, 0, 0}).data(), of("rotation", {0, 0, 0, 1}).data(), of("scale", {1, 1, 1}).data());
}

std::vector<std::vector<Instance>> listInstances(const Document& document, const Matrix& root, Budget& budget,
                                                 std::vector<Instance>& lights) {
  std::vector<std::vector<Instance>> out(document.model.meshes.size());
  std::vector<Instance> stack;
  for (size_t i = document.roots.size(); i-- > 0;) stack.push_back({root, static_cast<int>(document.roots[i])});
  while (!stack.empty()) {
    const Instance parent = stack.back();
    stack.pop_back();
    const tinygltf::Node& node = document.model.nodes[static_cast<size_t>(parent.node)];
    const auto visibility = node.extensions.find("KHR_node_visibility");
    if (visibility != node.extensions.end() && visibility->second.Has("visible") &&
        !visibility->second.Get("visible").Get<bool>())
      continue;
    const Instance here{multiply(parent.to_world, localTransform(node)), parent.node};
    for (const double v : here.to_world)
      if (!std::isfinite(v)) refuse("node " + std::to_string(here.node), "its world transform overflows");
    if (document.lights.of_node.count(static_cast<uint32_t>(here.node))) lights.push_back(here);
    if (node.mesh >= 0) {
      auto& list = out[static_cast<size_t>(node.mesh)];
      const auto instancing = node.extensions.find("EXT_mesh_gpu_instancing");
      if (instancing == node.extensions.end())
        list.push_back(here);
      else
        addGpuInstances(document, instancing->second, here, list, budget);
    }
    for (size_t i = node.children.size(); i-- > 0;) stack.push_back({here.to_world, node.children[i]});
  }
  return out;
}

}  // namespace ff::bake::gltf
