// Packed rows to entries (column slot << kCountBits | count) through the page table: a subgroup takes a row, a lane a run. A run
// lies in one partner tile; neighbours that resolve to one slot merge within it, as in MatrixAssembler, entry for entry.
// Rows of leaves only.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { JobPush push; };
layout(std430, binding = 0) readonly buffer Jobs { TileJob jobs[]; };
layout(std430, binding = 1) readonly buffer Packed { uint packed_words[]; };
layout(std430, binding = 2) readonly buffer Pages { uint pages[]; };
layout(std430, binding = 3) readonly buffer Kinds { uint kinds[]; };
layout(std430, binding = 4) buffer Rows { GatherRow rows[]; };
layout(std430, binding = 5) buffer Entries { uint entries[]; };

uint half_word(uint at) { return (packed_words[at >> 1] >> ((at & 1u) * 16u)) & 0xffffu; }
// From the first slot of the page on.
uint indexOf(uint page, uint column) { return (pages[page * kPageWords + 1u + (column >> 2)] >> ((column & 3u) * 8u)) & 0xffu; }

void main() {
  const uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
  const TileJob job = jobs[push.first + gl_WorkGroupID.x / push.groups];
  const uint runs_at = job.packed_at + 2u * (job.nodes + 1u) + kNodeWords * job.nodes;
  for (uint node = gl_WorkGroupID.x % push.groups * gl_NumSubgroups + gl_SubgroupID; node < job.nodes;
       node += push.groups * gl_NumSubgroups) {
    const uint slot = job.first_slot + node;
    if (kinds[slot] != kLeaf) continue;
    const uint run_end = packed_words[job.packed_at + node + 1u];
    uint word = 2u * (job.packed_at + job.words_at) + packed_words[job.packed_at + job.nodes + 1u + node];
    const uint first_entry = rows[slot].first * kEntriesPerLoad;
    uint entry = first_entry;
    for (uint run = packed_words[job.packed_at + node]; run < run_end; run += lanes) {
      const bool mine = run + lane < run_end;
      const uint described = mine ? packed_words[runs_at + run + lane] : 0u, words = described >> 16;
      const uint page = mine ? packed_words[job.packed_at + job.pages_at + (described & 0xffffu)] : 0u;
      const uint begin = word + subgroupExclusiveAdd(words), none = 0xffffffffu;
      uint count = 0u, last = none;
      for (uint k = 0u; k < words; ++k) {
        const uint index = indexOf(page, half_word(begin + k) >> 8);
        count += index != last ? 1u : 0u;
        last = index;
      }
      const uint first_slot = mine ? pages[page * kPageWords] : 0u;
      uint to = entry + subgroupExclusiveAdd(count), sum = 0u;
      last = none;
      for (uint k = 0u; k < words; ++k) {
        const uint packed_entry = half_word(begin + k), index = indexOf(page, packed_entry >> 8);
        if (index != last && last != none) entries[to++] = sum;
        sum = (index != last ? (first_slot + index) << kCountBits : sum) + (packed_entry & 0xffu);
        last = index;
      }
      if (words > 0u) entries[to] = sum;
      word += subgroupAdd(words);
      entry += subgroupAdd(count);
    }
    const uint written = entry - first_entry;
    const uint padding = (kEntriesPerLoad - written % kEntriesPerLoad) % kEntriesPerLoad;
    for (uint p = lane; p < padding; p += lanes) entries[entry + p] = 0u;
    if (lane == 0u) rows[slot].entries = written;
  }
}
