// matrix += tall * wide in columns [first, end): a work group a tile of 64 x 64, the factors in shared memory, 8 x 8
// elements an invocation in registers.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kFoldGroup) in;

shared vec4 tall[kFoldDepth][kBounceTile / 4u];
shared vec4 wide[kFoldDepth][kBounceTile / 4u];

void main() {
  if ((status | corrupt) != 0u) return;
  const uint first_tile = push.first / kBounceTile;
  const uint across = (push.end + kBounceTile - 1u) / kBounceTile - first_tile;
  const uint row0 = gl_WorkGroupID.x / across * kBounceTile;
  const uint column0 = (first_tile + gl_WorkGroupID.x % across) * kBounceTile;
  const uint t = gl_LocalInvocationID.x, down = t / 8u, right = t % 8u;
  // Rows 4 down + 0..3 and 32 + the same; columns 4 right + 0..3 and 32 + the same.
  vec4 sum[16];
  for (uint i = 0u; i < 16u; ++i) sum[i] = vec4(0);
  for (uint depth = 0u; depth < push.k; depth += kFoldDepth) {
    barrier();
    for (uint at = t; at < kFoldDepth * kBounceTile / 4u; at += kFoldGroup) {
      const uint d = at / (kBounceTile / 4u), four = at % (kBounceTile / 4u), c = depth + d;
      vec4 u = vec4(0), w = vec4(0);
      if (c < push.k) {
        u = panel_fours[tallAt(c, row0) / 4u + four];
        const uvec4 column = column0 + 4u * four + uvec4(0, 1, 2, 3);
        const bvec4 wanted = bvec4(uvec4(greaterThanEqual(column, uvec4(push.first))) &
                                   uvec4(lessThan(column, uvec4(push.end))));
        w = mix(vec4(0), panel_fours[wideAt(c, column0) / 4u + four], wanted);
      }
      tall[d][four] = u;
      wide[d][four] = w;
    }
    barrier();
    for (uint d = 0u; d < kFoldDepth; ++d) {
      const vec4 u0 = tall[d][down], u1 = tall[d][8u + down], w0 = wide[d][right], w1 = wide[d][8u + right];
// Written out: every index is a constant, so that all 64 sums stay in registers whatever the compiler unrolls.
#define ADD(i, u)          \
  sum[2 * i] += (u) * w0; \
  sum[2 * i + 1] += (u) * w1;
      ADD(0, u0.x) ADD(1, u0.y) ADD(2, u0.z) ADD(3, u0.w)
      ADD(4, u1.x) ADD(5, u1.y) ADD(6, u1.z) ADD(7, u1.w)
    }
  }
  const uint corner = (row0 * push.stride + column0) / 4u + right, stride = push.stride / 4u;
#define STORE(i)                                                                  \
  {                                                                               \
    const uint at = corner + (4u * down + (i) / 4u * 32u + (i) % 4u) * stride;    \
    plane[at] = packFour(unpackFour(plane[at]) + sum[2u * (i)]);                  \
    plane[at + 8u] = packFour(unpackFour(plane[at + 8u]) + sum[2u * (i) + 1u]);   \
  }
  STORE(0u) STORE(1u) STORE(2u) STORE(3u) STORE(4u) STORE(5u) STORE(6u) STORE(7u)
}
