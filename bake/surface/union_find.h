// Disjoint sets of 0..n-1; a set's name is its least member.
#pragma once
#include <algorithm>
#include <cstdint>
#include <numeric>

#include "bake/paging.h"

namespace ff::bake {

struct UnionFind {
  PagedVector<uint32_t> parent;
  explicit UnionFind(size_t n) : parent(n) { std::iota(parent.begin(), parent.end(), 0u); }
  uint32_t find(uint32_t i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  }
  void join(uint32_t a, uint32_t b) {
    a = find(a);
    b = find(b);
    if (a != b) parent[std::max(a, b)] = std::min(a, b);
  }
};

}  // namespace ff::bake
