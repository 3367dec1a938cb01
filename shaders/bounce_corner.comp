// The corner: S = F_PP + F_PL C U where the block enters, G_PP where it leaves; a subgroup an element. It is also what the
// raw wide factor has in the columns of the block.
#version 450
#define SCALAR
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

void main() {
  const uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
  for (uint at = gl_WorkGroupID.x * gl_NumSubgroups + gl_SubgroupID; at < push.k * push.k;
       at += gl_NumWorkGroups.x * gl_NumSubgroups) {
    const uint r = at / push.k, c = at % push.k;
    float sum = 0.0;
    if (push.leaving != 0u) {
      sum = panels[rawAt(r, placeOf(c))];
    } else {
      for (uint e = block[kBlockRowStart + r] + lane; e < block[kBlockRowStart + r + 1u]; e += lanes) {
        const uint place = block[rowEntries() + 2u * e], entering = indexOf(place);
        const float value = uintBitsToFloat(block[rowEntries() + 2u * e + 1u]);
        if (entering == kNotInBlock)
          sum += value * albedoOf(place) * panels[tallAt(c, place)];
        else if (entering == c)
          sum += value;
      }
      sum = subgroupAdd(sum);
    }
    if (lane == 0u) {
      panels[cornerAt(r, c)] = sum;
      panels[rawAt(r, placeOf(c))] = sum;
    }
  }
}
