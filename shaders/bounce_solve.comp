// K = (I - S C_P)^-1 where the block enters, (I + G_PP C_P)^-1 where it leaves: one work group, Gauss-Jordan elimination
// in place with partial pivoting, in shared memory. Refuses (status 1) where the rounding that S carries leaves K without
// correct digits, and where K, a sum of powers of S C_P >= 0, has come out negative.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

shared float a[kBounceBlock][kBounceBlock + 1u];  // one more: columns would otherwise share a bank
shared float best[kBounceBlock];
shared uint best_row[kBounceBlock];
shared uint swapped[kBounceBlock];
shared uint broken;

#ifdef HALF
const float kCarried = 1.0 / 4096.0, kMaxError = 0.5;  // the matrix itself was rounded so
#else
const float kCarried = 1.0 / 4194304.0, kMaxError = 1.0 / 64.0;
#endif
const float kRounded = 1.0 / 16777216.0;

float largestRowSum() {
  const uint t = gl_LocalInvocationID.x;
  if (t < kBounceBlock) {
    float sum = 0.0;
    if (t < push.k)
      for (uint c = 0u; c < push.k; ++c) sum += abs(a[t][c]);
    best[t] = sum;
  }
  barrier();
  float largest = 0.0;
  for (uint r = 0u; r < push.k; ++r) largest = best[r] > largest || isnan(best[r]) ? best[r] : largest;
  barrier();
  return largest;
}

void main() {
  const uint t = gl_LocalInvocationID.x, k = push.k;
  for (uint at = t; at < k * k; at += kBounceGroup) {
    const uint r = at / k, c = at % k;
    const float sc = panels[cornerAt(r, c)] * blockAlbedo(push.channel, c);
    a[r][c] = push.leaving != 0u ? sc : -sc;
  }
  if (t == 0u) broken = 0u;
  barrier();
  const float carried = largestRowSum();
  if (t < k) a[t][t] += 1.0;
  barrier();
  for (uint step = 0u; step < k; ++step) {
    if (t < kBounceBlock) {
      const float v = t >= step && t < k ? abs(a[t][step]) : -1.0;
      best[t] = isnan(v) ? -1.0 : v;
      best_row[t] = t;
    }
    barrier();
    for (uint half_width = kBounceBlock / 2u; half_width > 0u; half_width /= 2u) {
      if (t < half_width && best[t + half_width] > best[t]) {
        best[t] = best[t + half_width];
        best_row[t] = best_row[t + half_width];
      }
      barrier();
    }
    const uint pivot_row = best_row[0];
    if (t == 0u) {
      swapped[step] = pivot_row;
      if (!(best[0] > 0.0) || isinf(best[0])) broken = 1u;
    }
    barrier();
    if (broken != 0u) break;  // the same for all: read after a barrier, written before it
    if (t < k) {
      const float upper = a[pivot_row][t];
      a[pivot_row][t] = a[step][t];
      a[step][t] = upper;
    }
    barrier();
    const float scale = 1.0 / a[step][step];
    barrier();
    if (t < k) a[step][t] = (t == step ? 1.0 : a[step][t]) * scale;
    barrier();
    // An invocation takes half a row, the step's own column last: all others need its old value.
    const uint r = t / 2u, from = t % 2u * (kBounceBlock / 2u);
    const float factor = r < k && r != step ? a[r][step] : 0.0;
    barrier();
    if (r < k && r != step)
      for (uint c = from; c < min(from + kBounceBlock / 2u, k); ++c)
        a[r][c] = (c == step ? 0.0 : a[r][c]) - factor * a[step][c];
    barrier();
  }
  if (broken == 0u) {
    for (uint back = k; back > 0u; --back) {
      const uint step = back - 1u, other = swapped[step];
      if (t < k && other != step) {
        const float left = a[t][step];
        a[t][step] = a[t][other];
        a[t][other] = left;
      }
    }
    barrier();
    const float norm = largestRowSum();
    if (!((carried * kCarried + kRounded) * norm <= kMaxError)) broken = 1u;  // the same for all
    for (uint at = t; at < k * k; at += kBounceGroup) {
      const float inverse = a[at / k][at % k];
      if (push.leaving == 0u && inverse < -1e-3 * norm) broken = 1u;
      panels[inverseAt(at / k, at % k)] = inverse;
    }
  }
  barrier();
  if (broken != 0u && t == 0u) {
    status = 1u;
    if (push.leaving != 0u) corrupt = kSpoiltPrecision;  // those that should have left are still in the matrix
  }
}
