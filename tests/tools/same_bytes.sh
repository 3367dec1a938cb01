#!/usr/bin/env bash
# usage: same_bytes.sh FFBAKE FFSCENE EMBREE_ISA SHARED_SCENES FOLDER : scenes and worlds are the same to the byte whatever the processor
# and number of threads. This one passes for lesser ones: Embree held to an instruction set by the library EMBREE_ISA, glibc without its
# variants for AVX2 and FMA, libjpeg-turbo with SSE2 alone.
set -euo pipefail
ffbake=$1 ffscene=$2 embree_isa=$3 shared=$(realpath -m "$4") folder=$5
. "${BASH_SOURCE[0]%/*}/command.sh"
lesser=(env GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA JSIMD_FORCESSE2=1)
sines='import math; print([math.sin(i / 7).hex() for i in range(20000)])'
[ "$(python3 -c "$sines")" != "$("${lesser[@]}" python3 -c "$sines")" ] ||
  echo "note: the C library has no other variants on this processor; they are not tested"
held() {  # held ISA command...
  FF_EMBREE=isa=$1,verbose=1 LD_PRELOAD=$embree_isa ASAN_OPTIONS=verify_asan_link_order=0 "${@:2}"
}

mkdir scenes lesser
towns=(sh -c "'$ffscene' cap -o cap.glb && '$ffscene' discs -o discs.glb && '$ffscene' two-rooms -o two-rooms.glb &&
  '$ffscene' town --patches 10k -o town.glb --camera town.json")
(cd scenes && expect 0 "${towns[@]}")
(cd lesser && expect 0 "${lesser[@]}" "${towns[@]}")
rm {scenes,lesser}/{out,err}.txt
diff -rq scenes lesser || fail "the bytes of scenes hang on the processor"

isas=()
for isa in sse2 avx avx2 avx512; do
  held $isa "$ffbake" scenes/cap.glb -o cap.ffm --patch-size 1 --rays 64 --no-cache --quiet >out.txt 2>err.txt || true
  if grep -q 'Embree cannot start' err.txt; then
    echo "note: this processor has no $isa; it is not tested"
  else
    grep -q 'Embree Ray Tracing Kernels' out.txt err.txt || fail "Embree is not held to $isa: $(cat out.txt err.txt)"
    isas+=($isa)
  fi
done
[ ${#isas[@]} -ge 2 ] || fail "one instruction set only: ${isas[*]}"

world() {  # world NAME SCENE options...
  local name=$1 isa threads=1; shift
  rm -rf best && mkdir best && (cd best && expect 0 "$ffbake" "$1" -o "$name.ffm" --no-cache --quiet "${@:2}" && rm {out,err}.txt)
  [ -n "$(ls best)" ] || fail "$name: nothing was written"
  for isa in "${isas[@]}"; do
    rm -rf other && mkdir other
    (cd other && expect 0 held $isa "${lesser[@]}" "$ffbake" "$1" -o "$name.ffm" --no-cache --quiet --threads $threads "${@:2}" && rm {out,err}.txt)
    diff -rq best other || fail "$name: the bytes hang on the processor: $isa, $threads threads"
    threads=$((3 - threads))
  done
}
world cap "$PWD/scenes/cap.glb" --patch-size 0.2 --rays 256
world two-rooms "$PWD/scenes/two-rooms.glb" --patch-size 0.5 --rays 256
world town "$PWD/scenes/town.glb" --patch-size 8 --rays 64
if [ -d "$shared" ]; then
  world cornell "$shared/cornell/cornell.glb" --patch-size 0.02 --rays 64
  world sheet "$shared/trials/room_sheet.glb" --patch-size 1 --rays 64
  world cutout "$shared/edge/asset_generator/Material_AlphaMask/Material_AlphaMask_01.gltf" --patch-size 0.1 --rays 64
  world dome "$shared/trials/dome_unlit.glb" --patch-size 1 --rays 64
  world crevices "$shared/quake_e3m4/quake_e3m4.glb" --patch-size 64 --rays 16
else
  echo "note: $shared is absent; its scenes are not baked"
fi
echo "scenes and worlds: the same bytes on ${isas[*]}"
