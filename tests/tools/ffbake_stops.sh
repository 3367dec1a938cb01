#!/usr/bin/env bash
# usage: ffbake_stops.sh FFBAKE FFSCENE FOLDER : killed, stopped, started twice, without memory, threads or anybody to talk to. KILLS: how many
# seeded kills (12).
set -euo pipefail
ffbake=$1 ffscene=$2 folder=$3
. "${BASH_SOURCE[0]%/*}/command.sh"
line() {  # line WORDS: the last command said so, in one line
  grep -qF -- "$1" err.txt || fail "no \"$1\": $(cat err.txt)"
  [ "$(grep -c . err.txt)" -le "${2:-1}" ] || fail "more than a line: $(cat err.txt)"
}
shards() { (cd "$1" && sha256sum w.ffm w.*.ffs); }
bake=("$ffbake" town.glb --patch-size 1 --rays 512 --samples 64)
expect 0 "$ffscene" town --patches 2k -o town.glb
mkdir whole
expect 0 "${bake[@]}" -o whole/w.ffm --no-cache --quiet
[ ! -e whole/w.cache ] || fail "a cache, although none was wanted"

# Killed again and again, the bytes are those of a bake that nobody disturbed. How long one takes is measured, so that kills fall all over it.
mkdir killed
took=$( { TIMEFORMAT=%R; time "${bake[@]}" -o whole/w.ffm --no-cache --quiet >/dev/null; } 2>&1 )
RANDOM=7 kills=0
for ((k = 0; k < ${KILLS:-12}; ++k)); do
  "${bake[@]}" -o killed/w.ffm --quiet >/dev/null 2>&1 & pid=$!
  sleep "$(awk -v t="$took" -v r="$RANDOM" 'BEGIN { print t * r / 32768 }')"
  kill -KILL $pid 2>/dev/null && kills=$((kills + 1))
  wait $pid 2>/dev/null || true
  if ((k % 4 == 3)); then  # what was kept is enough to go on from
    expect 0 "${bake[@]}" -o killed/w.ffm --quiet --json
    cmp <(shards whole) <(shards killed) || fail "other bytes after kill $k"
    rm -rf killed/*
  fi
done
[ $kills -gt 0 ] || fail "nothing was killed"
expect 0 "${bake[@]}" -o killed/w.ffm --quiet
cmp <(shards whole) <(shards killed) || fail "other bytes after the kills"
[ -z "$(find killed -name '*.part' -o -name '*.tmp' -o -name '*.lock')" ] || fail "halves are left: $(ls killed)"

# Signals: within a second, with a line, and the world that was there stays.
long=("$ffbake" town.glb --patch-size 1 --rays 8192 --samples 64 -o killed/w.ffm)
for signal in INT:130 TERM:143 HUP:129; do
  code=0
  env --default-signal "${long[@]}" >out.txt 2>err.txt & pid=$!  # a shell's background commands ignore SIGINT
  until grep -q '^patches' err.txt; do sleep 0.02; done
  sleep 0.7
  began=$(date +%s%N)
  kill -"${signal%:*}" $pid
  wait $pid || code=$?
  [ $((($(date +%s%N) - began) / 1000000)) -lt 1000 ] || fail "SIG${signal%:*}: not within a second"
  [ "$code" = "${signal#*:}" ] || fail "SIG${signal%:*}: exit $code"
  tail -n 1 err.txt | grep -qF 'stopped; the same command goes on from here' || fail "no line how to go on: $(cat err.txt)"
done
cmp <(shards whole) <(shards killed) || fail "a bake that was stopped changed the world"
[ -z "$(find killed -name '*.part' -o -name '*.tmp' -o -name '*.lock')" ] || fail "halves are left: $(ls killed)"
expect 0 "${long[@]}" --status --json
expect 0 "${long[@]}" --status --cache absent.cache
[ ! -e absent.cache ] || fail "--status made a cache"
expect 0 "${long[@]}" --status --json
python3 - <<'PY' || fail "nothing was kept: $(cat out.txt)"
import json
units = json.load(open("out.txt"))["cached_patches"]
assert 0 < units["clean"] and units["missing"] > 0 and units["stale"] == 0, units
PY
nohup "${bake[@]}" -o killed/w.ffm --quiet --no-cache >out.txt 2>err.txt & pid=$!
sleep 0.1; kill -HUP $pid; wait $pid || fail "nohup does not hold: $(cat err.txt)"

# Two at a time under one name.
"${long[@]}" >/dev/null 2>&1 & pid=$!
until [ -e killed/w.ffm.lock ]; do sleep 0.02; done
expect 2 "${bake[@]}" -o killed/w.ffm --quiet
line 'another program is writing it'
kill -TERM $pid; wait $pid || true
expect 0 "${bake[@]}" -o killed/w.ffm --quiet
cmp <(shards whole) <(shards killed) || fail "two at a time spoil the world"

# Outputs that cannot be, before the first ray.
cp town.glb town.ffm
expect 1 "$ffbake" town.ffm -o town.ffm; line 'would take the place of the scene'
expect 1 "$ffbake" town.ffm -o ./town.ffm; line 'would take the place of the scene'
cmp town.glb town.ffm || fail "the scene is gone"
expect 1 "${bake[@]}" -o a.ffm --write-vdb town.glb; line 'would take the place of the scene'
expect 1 "${bake[@]}" -o a.ffm --write-vdb a.ffm; line 'would take the place of the world'
mkdir folder.ffm
expect 2 "${bake[@]}" -o folder.ffm --quiet; line 'is not a regular file'
expect 1 "${bake[@]}" -o "$(printf 'x%.0s' {1..240}).ffm" --quiet --no-cache; line 'too long'
expect 2 "${bake[@]}" -o absent/w.ffm --quiet --no-cache; line 'absent/'
expect 2 "${bake[@]}" -o a.ffm --quiet --cache town.glb; line 'town.glb'
expect 1 "${bake[@]}" -o a.ffm --status --no-cache; line 'no cache'
expect 1 "$ffbake" -o a.ffm; line 'no scene'
[ ! -e a.ffm ] && [ ! -e a.ffm.lock ] || fail "something was written"

# Nobody to talk to, no memory, no threads.
code=0; "${bake[@]}" -o killed/w.ffm --cache c >out.txt 2>&- || code=$?
[ $code = 0 ] || fail "closed stderr: exit $code"
cmp <(shards whole) <(shards killed) || fail "stderr went into the world"
code=0; "${bake[@]}" -o killed/w.ffm --cache c 2> >(head -c 1 >/dev/null) >out.txt || code=$?
[ $code = 0 ] || fail "a reader of stderr that is gone: exit $code"
for out in '&-' /dev/full; do
  code=0; eval '"${bake[@]}"' -o killed/w.ffm --cache c --quiet ">$out" 2>err.txt || code=$?
  [ $code = 2 ] || fail "stdout $out: exit $code"
  line 'stdout'
  for other in '"$ffscene" town --patches 2k -o b.glb' '"$ffbake" --help'; do
    code=0; eval "$other" ">$out" 2>err.txt || code=$?
    [ $code = 2 ] || fail "$other, stdout $out: exit $code"
  done
done
cmp <(shards whole) <(shards killed) || fail "stdout went into the world"
for limit in '-v 400000' '-v 700000'; do
  code=0; (ulimit $limit; "${bake[@]}" -o killed/w.ffm --no-cache --quiet >out.txt 2>err.txt) || code=$?
  [ $code = 0 ] || [ $code = 1 ] || [ $code = 2 ] || fail "ulimit $limit: exit $code: $(cat err.txt)"
  [ $code = 0 ] || [ "$(grep -c . err.txt)" = 1 ] || fail "ulimit $limit: not one line: $(cat err.txt)"
done
# Threads are counted by user, and root may have any number: nobody bakes. Whichever thread is the one too many, some of which libraries start before main().
mkdir nobodys && chmod 777 nobodys && cp town.glb nobodys
as_nobody=(); [ "$(id -u)" != 0 ] || as_nobody=(setpriv --reuid=65534 --regid=65534 --clear-groups)
if (cd nobodys && "${as_nobody[@]}" "$ffbake" --version >/dev/null 2>&1); then
  ended_in_a_line=0
  for ((most = 1; most <= 12; ++most)); do
    code=0; (cd nobodys && "${as_nobody[@]}" prlimit --nproc=$most:$most "$ffbake" town.glb -o w.ffm --patch-size 2 --rays 64 --samples 16 --no-cache --quiet >out.txt 2>../err.txt) || code=$?
    [ $code = 0 ] || [ $code = 2 ] || fail "$most threads: exit $code: $(cat err.txt)"
    [ $code = 0 ] || { line 'thread'; ended_in_a_line=$((ended_in_a_line + 1)); }
  done
  [ "$(id -u)" != 0 ] || [ $ended_in_a_line -gt 0 ] || fail "threads never ran out"
else
  echo "NOT TRIED: a limit on threads (nobody cannot run $ffbake)"
fi
cmp <(shards whole) <(shards killed) || fail "a bake without memory changed the world"

# A disk that fills up under a bake that puts aside what memory has no room for: one line, and nothing is left.
mkdir tiny
if mount -t tmpfs -o size=1m tmpfs tiny 2>/dev/null; then
  trap "umount '$PWD/tiny'" EXIT
  expect 0 "$ffscene" town --patches 12k -o more.glb
  expect 2 "$ffbake" more.glb -o tiny/w.ffm --patch-size 1 --rays 64 --samples 16 --no-geometry --no-cache --memory 95M --quiet
  line 'make room on that disk, or give more --memory'
  left=$(ls tiny)
  umount tiny && trap - EXIT
  [ -z "$left" ] || fail "left on a full disk: $left"
else
  echo "NOT TRIED: a disk that fills up (no right to mount one)"
fi

# For programs.
expect 0 "${bake[@]}" -o killed/w.ffm --cache c --json --json-progress
python3 - <<'PY' || fail "the JSON is wrong"
import json
phases = []
for text in open("err.txt"):
    line = json.loads(text)
    assert set(line) == {"phase", "done", "total", "seconds", "seconds_left"} and 0 <= line["done"] <= line["total"], line
    if line["done"] == line["total"] > 0: phases.append(line["phase"])
assert phases == ["import", "patches", "rays", "pyramid", "strips", "geometry"], phases
done = json.load(open("out.txt"))
assert list(done["seconds_by_phase"]) == sorted(phases) and done["peak_bytes"] > 0
assert done["cached_patches"]["missing"] == done["cached_patches"]["stale"] == 0 < done["cached_patches"]["clean"] and done["rays_cast"] == 0 < done["rays"], done
PY
expect 0 "$ffbake" -o killed/w.ffm --cache c --clean
[ ! -e c ] || fail "the cache is still there"
[ -z "$(find killed -name '*.lock')" ] || fail "a lock is left"
echo "ffbake: $kills kills, signals, outputs and limits"
