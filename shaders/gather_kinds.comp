// What slots are, from the parents of all: pass 0 makes every slot in use a leaf, pass 1 makes parents refined.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { JobPush push; };
layout(std430, binding = 0) readonly buffer Parents { uint parents[]; };
layout(std430, binding = 1) buffer Kinds { uint kinds[]; };

void main() {
  const uint slot = gl_GlobalInvocationID.x;
  if (slot >= push.count) return;
  const uint parent = parents[slot];
  if (push.groups == 0u)
    kinds[slot] = parent == kFreeSlot ? kFree : kLeaf;
  else if (parent < kFreeSlot)
    kinds[parent] = kRefined;  // siblings write the same
}
