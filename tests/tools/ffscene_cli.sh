#!/usr/bin/env bash
# usage: ffscene_cli.sh FFSCENE FOLDER : the command's files and exit codes.
set -euo pipefail
ffscene=$1 folder=$2
. "${BASH_SOURCE[0]%/*}/command.sh"
expect 0 "$ffscene" town -o a.glb --patches 2.5k --seed 3 --camera a.json
grep -qE '^faces +2[45][0-9][0-9]$' out.txt || fail "no face count near 2500: $(cat out.txt)"
expect 0 "$ffscene" town -o b.glb --patches 2500 --seed 3 --camera b.json --json
python3 -c 'import json,sys; d = json.load(open("out.txt")); assert abs(d["faces"] / 2500 - 1) < 0.05 and d["lamps"] > 0 and d["triangles"] == 2 * d["faces"], d'
cmp a.glb b.glb || fail "two runs differ"
cmp a.json b.json || fail "two camera paths differ"
expect 0 "$ffscene" town -o c.glb --patches 2500 --seed 4
! cmp -s a.glb c.glb || fail "the seed changes nothing"
expect 0 "$ffscene" town -o d.glb --patches 2500 --seed 3 --draco
[ "$(stat -c %s d.glb)" -lt "$(stat -c %s a.glb)" ] || fail "Draco is not smaller"
for scene in box plates "plates --layout perpendicular" discs cap two-rooms corridor; do
  # shellcheck disable=SC2086
  expect 0 "$ffscene" $scene -o x.glb
  [ "$(head -c 4 x.glb)" = glTF ] || fail "$scene is no .glb"
done
expect 0 "$ffscene" --version
expect 0 "$ffscene" --help
expect 1 "$ffscene"
expect 1 "$ffscene" town
expect 1 "$ffscene" town -o x.glb --patches 12x
expect 1 "$ffscene" town -o x.glb --patches 100
[ "$(wc -l <err.txt)" -eq 1 ] || fail "not one line: $(cat err.txt)"
expect 1 "$ffscene" box -o x.glb --albedo 2
expect 2 "$ffscene" box -o absent/x.glb
