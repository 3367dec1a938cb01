// wide x over the columns that are not folded in yet, [first, end): a subgroup a row of the factor and channel.
// count: channels.
#version 450
#define SCALAR
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

void main() {
  const uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
  for (uint at = gl_WorkGroupID.x * gl_NumSubgroups + gl_SubgroupID; at < push.k * push.count;
       at += gl_NumWorkGroups.x * gl_NumSubgroups) {
    const uint c = at % push.k, vector = vectorsOf(at / push.k);
    float sum = 0.0;
    for (uint column = push.first + lane; column < push.end; column += lanes)
      sum += panels[wideAt(c, column)] * vectors[vector + push.x_at + column];
    sum = subgroupAdd(sum);
    if (lane == 0u) vectors[vector + weightsAt() + c] = sum;
  }
}
