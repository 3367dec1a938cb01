// Tiles that entered: what their packed nodes say is spread over the arrays by slot. A node starts from its parent's
// radiosity; levels are dispatched from the coarsest down, so that the parent has its own.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { JobPush push; };
layout(std430, binding = 0) readonly buffer Jobs { TileJob jobs[]; };
layout(std430, binding = 1) readonly buffer Packed { uint packed_words[]; };
layout(std430, binding = 2) buffer Albedo { vec4 albedo[]; };  // w: area, m2
layout(std430, binding = 3) buffer Rows { GatherRow rows[]; };
layout(std430, binding = 4) buffer Parents { uint parents[]; };
layout(std430, binding = 5) buffer Siblings { uint siblings[]; };
layout(std430, binding = 6) buffer Radiosity { vec4 radiosity[]; };

void main() {
  const TileJob job = jobs[push.first + gl_WorkGroupID.x / push.groups];
  const uint node = gl_WorkGroupID.x % push.groups * kGatherGroup + gl_LocalInvocationID.x;
  if (node >= job.nodes) return;
  const uint slot = job.first_slot + node, at = job.packed_at + 2u * (job.nodes + 1u) + kNodeWords * node;
  albedo[slot] = vec4(uintBitsToFloat(packed_words[at]), uintBitsToFloat(packed_words[at + 1u]),
                      uintBitsToFloat(packed_words[at + 2u]), uintBitsToFloat(packed_words[at + 3u]));
  const uint row_start = packed_words[job.packed_at + job.nodes + 1u + node];
  // Room for a row is its number of words, rounded up; a little more is lost so that no sums over rows are needed.
  const uint first = job.entries_at + (row_start + kEntriesPerLoad - 1u) / kEntriesPerLoad + node;
  rows[slot] = GatherRow(first, 0u, job.segment, uintBitsToFloat(packed_words[at + 4u]));
  const uint parent = packed_words[at + 5u];
  parents[slot] = parent;
  siblings[slot] = packed_words[at + 6u];
  if (job.start == kStartKept) return;
  radiosity[slot] = job.start == kStartParent && parent != kTopSlot ? radiosity[parent] : vec4(0);
}
