#!/usr/bin/env bash
# usage: ffbake_ranks.sh FFBAKE FFSCENE FOLDER : one bake by several processes of mpirun, of which some are killed: the bytes of one process.
set -euo pipefail
ffbake=$1 ffscene=$2 folder=$3
command -v mpirun >/dev/null || { echo "SKIPPED: no mpirun here (openmpi-bin)"; exit 0; }
. "${BASH_SOURCE[0]%/*}/command.sh"
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
shards() { (cd "$1" && sha256sum w.ffm w.*.ffs); }
ranks() { mpirun --oversubscribe --bind-to none "$@"; }
bake=("$ffbake" town.glb --patch-size 1 --rays 512 --samples 64 --threads 1)
expect 0 "$ffscene" town --patches 8k -o town.glb
mkdir one many
expect 0 "${bake[@]}" -o one/w.ffm --no-cache --quiet
for n in 2 4; do
  expect 0 ranks -n $n "${bake[@]}" -o many/w.ffm --quiet --json
  python3 -c 'import json; u = json.load(open("out.txt"))["cached_patches"]; assert 0 < u["by_other_ranks"] < u["missing"], u' || fail "nobody helped: $(cat out.txt)"
  cmp <(shards one) <(shards many) || fail "other bytes by $n ranks"
  rm -rf many/*
done

# One rank is killed: RANK. With recovery the others go on; else mpirun ends them, and the same command goes on from there.
killed() {  # killed RANK OPTION...
  local rank=$1; shift
  ranks "$@" -n 3 "${bake[@]}" -o many/w.ffm --quiet >out.txt 2>err.txt & local all=$!
  local victim=
  until [ "$(ls many/w.cache 2>/dev/null | wc -l)" -gt 3 ]; do sleep 0.02; done
  for process in $(pgrep -f "^$ffbake town.glb .*many/w.ffm"); do
    tr '\0' '\n' <"/proc/$process/environ" 2>/dev/null | grep -qx OMPI_COMM_WORLD_RANK=$rank && victim=$process
  done
  [ -n "$victim" ] && kill -KILL "$victim" || fail "nobody to kill"
  code=0; wait $all || code=$?
}
killed 1 --enable-recovery
[ $code = 0 ] || fail "a rank that was killed took the others along: exit $code: $(cat err.txt)"
grep -q '1 of 3 ranks are gone' err.txt || fail "no line about the rank that is gone: $(cat err.txt)"
cmp <(shards one) <(shards many) || fail "other bytes without rank 1"
rm -rf many/*
killed 1
[ $code != 0 ] || fail "mpirun says that all is well"
[ ! -e many/w.ffm ] || fail "there is a world, although the bake was ended"
expect 0 ranks -n 2 "${bake[@]}" -o many/w.ffm --quiet --json
python3 -c 'import json; u = json.load(open("out.txt"))["cached_patches"]; assert u["clean"] > 0, u' || fail "all was done again: $(cat out.txt)"
cmp <(shards one) <(shards many) || fail "other bytes after a rank was killed"

# Rank 0 is killed, and nobody tells the others: they notice, and the same command goes on.
rm -rf many/*
killed 0 --enable-recovery
[ "$(grep -c 'rank 0 has said nothing' err.txt)" = 2 ] || fail "the others did not notice: $(cat err.txt)"  # mpirun itself exits with 0 all the same
[ ! -e many/w.ffm ] || fail "there is a world, although rank 0 was killed"
expect 0 ranks -n 2 "${bake[@]}" -o many/w.ffm --quiet --json
cmp <(shards one) <(shards many) || fail "other bytes after rank 0 was killed"

# What goes wrong on rank 0 ends all, with its line and its code.
code=0; ranks -n 2 "${bake[@]}" -o absent/w.ffm --cache c --quiet >out.txt 2>err.txt || code=$?
[ $code = 2 ] && [ "$(grep -c 'absent/' err.txt)" -ge 1 ] || fail "no such folder: exit $code: $(cat err.txt)"
code=0; ranks -n 2 "${bake[@]}" -o many/w.ffm --no-cache --quiet >out.txt 2>err.txt || code=$?
[ $code = 1 ] && grep -q 'is for one process' err.txt || fail "--no-cache: exit $code: $(cat err.txt)"
echo "ffbake: the same bytes by 1, 2 and 4 ranks, and without one that was killed"
