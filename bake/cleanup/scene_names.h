// What the objects of a scene are called: for messages, and for picking some by name.
#pragma once
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "bake/finding.h"
#include "bake/scene.h"

namespace ff::bake {

// The object that a triangle is of; null where nothing is known.
const Object* objectOf(const Scene& scene, uint32_t triangle);

// 'node "lamp 2", material "bulb"', with numbers for what has no name.
std::string placeOf(const Scene& scene, uint32_t triangle);

Vec3 middleOf(const Scene& scene, uint32_t triangle);

// Sums what is said of triangles by the object and material that they are of.
class PlaceSums {
 public:
  explicit PlaceSums(const Scene& scene) : scene_(scene) {}
  void add(uint32_t triangle, double weight, Vec3 at);  // at: on the triangle
  void add(uint32_t triangle, double weight = 1) { add(triangle, weight, middleOf(scene_, triangle)); }
  // The heaviest of them, each where its heaviest part is.
  void putInto(Finding& finding) const;

 private:
  struct Sum {
    uint32_t triangle;  // the first
    HeaviestPlace place;
  };
  const Scene& scene_;
  std::map<std::pair<uint32_t, uint32_t>, Sum> sums_;  // of (node or object, material)
};

// Of each triangle, whether the name of its node, mesh or material matches a pattern: * any text, ? one character, [abc].
std::vector<bool> matching(const Scene& scene, const std::string& pattern);

}  // namespace ff::bake
