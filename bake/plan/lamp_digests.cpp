#include "bake/plan/lamp_digests.h"

#include "formats/codec/bytes.h"
#include "formats/codec/checksum.h"

namespace ff::bake {

LampDigests::LampDigests(const LampTree& lamps, const PatchSet& set, const Contents& contents) : lamps_(lamps), set_(set), of_node_(lamps.nodes()) {
  for (uint32_t p = 0; p < set.patches.size(); ++p) {
    if (lamps.leafOf(p) == kNone) continue;
    formats::ByteWriter b;
    for (const uint64_t half : contents.surface(p, p + 1)) b.u64(half);
    b.vec3(set.patches[p].emission);
    b.u16(set.patches[p].lamp_group);
    of_node_[lamps.leafOf(p)] = formats::hashBytes(b.data());
  }
  for (size_t n = lamps.nodes(); n-- > 0;) {
    if (lamps.isLeaf(static_cast<uint32_t>(n))) continue;
    const auto [left, right] = lamps.children(static_cast<uint32_t>(n));
    formats::ByteWriter b;
    b.u64(of_node_[left]);
    b.u64(of_node_[right]);
    of_node_[n] = formats::hashBytes(b.data());
  }
}

uint64_t LampDigests::of(uint32_t patch, std::span<const uint32_t> met) const {
  std::vector<LampTree::Aim> aims;
  lamps_.aimsOf(receiverOf(set_, patch), aims);
  std::vector<uint64_t> all;
  for (const LampTree::Aim& aim : aims) all.push_back(of_node_[aim.node]);
  all.push_back(aims.size());
  for (const uint32_t lamp : met) all.push_back(lamps_.leafOf(lamp) == kNone ? 0 : of_node_[lamps_.leafOf(lamp)]);
  return formats::hashBytes(std::as_bytes(std::span(all)));
}

}  // namespace ff::bake
