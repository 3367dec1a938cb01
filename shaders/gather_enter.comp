// Tiles that entered: what their packed nodes say is spread over the arrays by slot. A node starts from its parent's
// radiosity, or its irradiance; levels are dispatched from the coarsest down, so that the parent has its own.
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
layout(std430, binding = 7) buffer Before { vec4 before[]; };  // what the last step came from
layout(std430, binding = 8) buffer LastSource { vec4 last_source[]; };  // of the last step; w: 1: entered since
layout(std430, binding = 9) buffer Held { vec4 held[]; };

// What a parent reflects, on the albedo of its child; as it is where the parent's albedo is 0.
vec4 onAlbedo(vec3 b, vec3 from, vec3 to) { return vec4(mix(b, b / from * to, greaterThan(from, vec3(0))), 0); }

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
  last_source[slot] = vec4(0, 0, 0, 1);
  held[slot] = vec4(0);
  if (job.start == kStartEased && parent != kTopSlot) {
    radiosity[slot] = onAlbedo(radiosity[parent].rgb, albedo[parent].rgb, albedo[slot].rgb);
    before[slot] = onAlbedo(before[parent].rgb, albedo[parent].rgb, albedo[slot].rgb);
    return;
  }
  radiosity[slot] = job.start != kStartZero && parent != kTopSlot ? radiosity[parent] : vec4(0);
}
