#!/usr/bin/env bash
# usage: ffview_town.sh FFSCENE FFBAKE FFVIEW FOLDER : a small town from nothing to pictures, and ffview's exit codes.
set -euo pipefail
ffscene=$1 ffbake=$2 ffview=$3 folder=$4
. "${BASH_SOURCE[0]%/*}/command.sh"
expect 0 "$ffscene" town -o town.glb --patches 2500 --camera camera.json
expect 0 "$ffbake" town.glb -o town.ffm --patch-size 1 --rays 256 --quiet
if ! "$ffview" --headless town.ffm -o probe --frames 1 --size 64x48 --no-difference --validate >out.txt 2>err.txt; then
  if grep -q -e "no Vulkan driver" -e "no usable device" -e "is not installed" err.txt; then
    echo "SKIPPED, nothing was tested: $(cat err.txt)"; exit 77
  fi
  fail "$(cat err.txt)"
fi
expect 0 "$ffview" --headless town.ffm --camera camera.json -o pictures --frames 2 --size 160x90 --radius 8 --validate --json
python3 - out.txt pictures <<'PY'
import json, os, struct, sys
figures = json.load(open(sys.argv[1]))
assert figures == json.load(open(os.path.join(sys.argv[2], "figures.json")))
assert len(figures["frames"]) == 2
for f in figures["frames"]:
    assert f["slots"] > 0 and f["entries"] > 0 and f["solve_ms"] > 0, f
    for kind in ("direct", "bounce", "difference"):
        data = open(os.path.join(sys.argv[2], f[kind + "_picture"]), "rb").read()
        assert data[:8] == b"\x89PNG\r\n\x1a\n" and struct.unpack(">II", data[16:24]) == (160, 90)
    # The first key stands in the town: its patches agree with the full solve to the cut's error.
first = figures["frames"][0]
assert first["patches_compared"] > 20, first
assert first["reflected_error_inner"] < 0.03, first
PY
cp pictures/town_0000_bounce.png vulkan.png
# Light that has not settled is said, with how much; an error that was not computed has its reason.
expect 0 "$ffview" --headless town.ffm --camera camera.json -o undone --frames 1 --size 64x48 --settle 2 --no-difference
grep -q "has not settled in 1 of 1 pictures: .* raise --settle" err.txt || fail "undone light was not said: $(cat err.txt)"
expect 0 "$ffview" --headless town.ffm -o night --frames 1 --size 64x48 --night
[ ! -s err.txt ] || fail "settled light was complained of: $(cat err.txt)"
# A night without lamps is black, and that is said.
expect 0 "$ffscene" plates -o plates.glb --emission 0
expect 0 "$ffbake" plates.glb -o plates.ffm --patch-size 0.25 --rays 64 --quiet
expect 0 "$ffview" --headless plates.ffm -o black --frames 1 --size 64x48 --night
grep -q "nothing shines" err.txt || fail "a black night was not said: $(cat err.txt)"
expect 0 "$ffview" --headless town.ffm --camera camera.json -o near --frames 1 --size 64x48 --radius 0.01
python3 - <<'PY'
import json
frame = lambda name: json.load(open(name + "/figures.json"))["frames"][0]
undone, night, near = frame("undone"), frame("night"), frame("near")
assert undone["settled"] is False and 1e-6 < undone["settle_change"] < 1, undone
assert undone["reflected_error_inner"] is None and "--no-difference" in undone["not_compared_because"], undone
assert night["settled"] is True and night["settle_change"] <= 1e-6, night
assert night["reflected_error_inner"] is not None and "not_compared_because" not in night, night
assert json.load(open("night/figures.json"))["sun"]["irradiance"] == [0, 0, 0]
json.dump(json.load(open("night/figures.json"))["camera"], open("found.json", "w"))
assert near["reflected_error_inner"] is None and "raise --radius" in near["not_compared_because"], near
PY
# A path that was found can be flown again.
expect 0 "$ffview" --headless town.ffm -o again --camera found.json --frames 1 --size 64x48 --night
cmp night/town_0000_bounce.png again/town_0000_bounce.png || fail "another picture from the same place"
expect 0 "$ffview" --headless town.ffm --camera camera.json -o on_cpu --frames 2 --size 160x90 --radius 8 --solve-on-cpu --validate
expect 0 "$ffview" --headless town.ffm --camera camera.json -o dense --frames 2 --size 160x90 --radius 4 --solver multibounce --solve-on-cpu --validate
expect 1 "$ffview" --headless town.ffm -o x --solver magic
expect 1 "$ffview" town.ffm -o x
expect 1 "$ffview" --headless town.ffm -o x --size 3by4
expect 1 "$ffview" --headless town.ffm -o x --sun north
expect 2 "$ffview" --headless absent.ffm -o x
expect 2 "$ffview" --headless town.ffm -o x --camera absent.json
expect 2 "$ffview" --headless town.ffm -o x --device "no such device"
echo nonsense >bad.json
expect 3 "$ffview" --headless town.ffm -o x --camera bad.json
head -c 100 town.ffm >cut.ffm
expect 3 "$ffview" --headless cut.ffm -o x
