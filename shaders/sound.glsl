// Whether light is finite and within kMaxRadiosity; by its bits, since drivers may take isnan() for false.
bool isSound(vec3 v) {
  return all(lessThanEqual(floatBitsToUint(v) & 0x7fffffffu, uvec3(floatBitsToUint(kMaxRadiosity))));
}
// Of its channels.
float largestOf(vec3 v) { return max(v.r, max(v.g, v.b)); }
