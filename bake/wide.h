// Plain loops compiled for registers of 512, 256 and 128 bits: the widest that the processor has are taken. All do the same operations on each element, and
// so give the same bits.
#pragma once

namespace ff::bake {

template <class Loop, class... Arguments>
struct Wide {
  [[gnu::target("avx512f,avx512bw,avx512dq,avx512vl,prefer-vector-width=512")]] static auto on512(Arguments... a) { return Loop::run(a...); }
  [[gnu::target("avx2")]] static auto on256(Arguments... a) { return Loop::run(a...); }
  static auto on128(Arguments... a) { return Loop::run(a...); }
  static auto* widest() {
    auto* run = on128;
    if (__builtin_cpu_supports("avx2")) run = on256;
    if (__builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) run = on512;
    return run;
  }
};

// Loop::run(arguments...): static, [[gnu::always_inline]], and so is what it calls.
template <class Loop, class... Arguments>
auto onWidest(Arguments... arguments) {
  static auto* const run = Wide<Loop, Arguments...>::widest();
  return run(arguments...);
}

}  // namespace ff::bake
