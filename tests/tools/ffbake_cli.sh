#!/usr/bin/env bash
# usage: ffbake_cli.sh FFBAKE FFSCENE FOLDER : objects chosen by name, and what it says where they cannot be.
set -euo pipefail
ffbake=$1 ffscene=$2 folder=$3
. "${BASH_SOURCE[0]%/*}/command.sh"
refused() {  # refused WORDS density...: one line that holds the words, and no world
  local words=$1; shift
  expect 1 "$ffbake" two.glb -o w.ffm --patch-size 0.5 --rays 64 --no-cache --quiet "${@/#/--density=}"
  [ "$(wc -l <err.txt)" -eq 1 ] || fail "not one line: $(cat err.txt)"
  grep -qF -- "$words" err.txt || fail "no \"$words\": $(cat err.txt)"
  [ ! -e w.ffm ] || fail "a world was written"
}
patches() { python3 -c 'import json; print(json.load(open("out.txt"))["levels"][0]["nodes"])'; }
expect 0 "$ffscene" two-rooms -o two.glb
# Behind a web server nothing is written, nor into a folder of that name.
expect 2 "$ffbake" two.glb -o http://127.0.0.1:9/w.ffm --patch-size 0.5
grep -q '^ffbake: http://127.0.0.1:9/w.ffm: what lies behind a web server is only read; write to a folder' err.txt && [ ! -e http: ] || fail "no remedy: $(cat err.txt)"
bake() { expect 0 "$ffbake" two.glb -o w.ffm --patch-size 0.5 --rays 64 --no-cache --quiet --json "$@"; }
bake
plain=$(patches)
bake --density '*=2'
[ "$(patches)" -gt $((3 * plain)) ] || fail "$plain patches, $(patches) at density 2"
bake --density '*=1.9'
grep -q '1.9 is rounded to 2' err.txt || fail "rounding is not said: $(cat err.txt)"
rm -f w.*
refused 'not PATTERN=NUMBER' wall
refused 'not PATTERN=NUMBER' wall=
refused 'not PATTERN=NUMBER' =2
refused 'not PATTERN=NUMBER' 'wall=2x'
refused '0.0625 to 16' 'wall=17'
refused '0.0625 to 16' 'wall=0'
refused '0.0625 to 16' 'wall=nan'
refused 'named "absent"' 'absent=2'
refused 'named "a=b"' 'a=b=2'
for error in 0 -1 100 2%% two ''; do
  expect 1 "$ffbake" two.glb -o w.ffm --patch-size 0.5 --quiet --no-cache --target-error "$error"
  grep -qF 'is not a per cent' err.txt || fail "--target-error '$error': $(cat err.txt)"
done
bake_to() { expect 0 "$ffbake" two.glb -o w.ffm --patch-size 0.5 --no-cache --quiet --json "$@"; python3 -c 'import json; b = json.load(open("out.txt")); print(b["rays"] // b["levels"][0]["nodes"], b["fewest_rays"])'; }
read -r coarse least <<<"$(bake_to --target-error 8)"
read -r fine _ <<<"$(bake_to --target-error 1.5%)"
read -r most _ <<<"$(bake_to --target-error 0.1% --rays 300)"
[ "$coarse" -lt "$fine" ] && [ "$least" = 256 ] && [ "$most" -le 300 ] || fail "rays by error: $coarse (least $least), $fine, $most"
rm -f w.*
# A ground of 100 km with patches of 1 m, alone or as tiles of 10 km in a list, is refused before any work, whatever memory there is.
python3 - <<'PY'
import base64, json, struct
def ground(name, m):
    data = struct.pack("<12f", 0, 0, 0, 0, 0, m, m, 0, m, m, 0, 0) + struct.pack("<6H", 0, 1, 2, 0, 2, 3)
    json.dump({"asset": {"version": "2.0"}, "buffers": [{"byteLength": 60, "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}],
               "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
               "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [m, 0, m]}, {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
               "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0}}],
               "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}, open(name, "w"))
ground("ground.gltf", 100000)
ground("tile.gltf", 10000)
json.dump({"files": [{"path": "tile.gltf", "translation": [10000 * (i % 10), 0, 10000 * (i // 10)]} for i in range(100)]}, open("tiles.json", "w"))
PY
for size in --patch-size=1 --patch-budget=10G; do
  for scene in ground.gltf tiles.json; do
    expect 1 "$ffbake" "$scene" -o w.ffm "$size" --memory 100T --no-cache --quiet
    grep -q 'about 10G patches are more than a bake makes, which cuts surface into 500M pieces at most; use ' err.txt && [ "$(wc -l <err.txt)" -eq 1 ] && [ ! -e w.ffm ] || fail "$scene $size: $(cat err.txt)"
  done
done
# What is odd about a scene: one line a kind, and the same for programs. A ground; above it a cube without a side, and a cube twice at one place.
python3 - <<'PY'
import json, struct
faces = [((0,0,0),(1,0,0),(1,0,1),(0,0,1)), ((0,0,0),(0,0,1),(0,1,1),(0,1,0)), ((1,0,0),(1,1,0),(1,1,1),(1,0,1)), ((0,0,0),(0,1,0),(1,1,0),(1,0,0)),
         ((0,0,1),(1,0,1),(1,1,1),(0,1,1)), ((0,1,0),(0,1,1),(1,1,1),(1,1,0))]
def quad(p): return [p[0], p[1], p[2], p[0], p[2], p[3]]
def cube(at, without=None): return [(x + at[0], y + at[1], z + at[2]) for i, f in enumerate(faces) if i != without for x, y, z in quad(f)]
meshes = [("ground", quad([(-9, 0, -9), (-9, 0, 9), (9, 0, 9), (9, 0, -9)])), ("open crate", cube((3, 1, 0), 2)), ("crate", cube((0, 1, 0))), ("crate again", cube((0, 1, 1e-7)))]
data, views, accessors = b"", [], []
for name, corners in meshes:
    part = b"".join(struct.pack("<3f", *c) for c in corners)
    views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(part)})
    accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": len(corners), "type": "VEC3",
                      "min": [min(c[k] for c in corners) for k in range(3)], "max": [max(c[k] for c in corners) for k in range(3)]})
    data += part
open("odd.bin", "wb").write(data)
json.dump({"asset": {"version": "2.0"}, "buffers": [{"uri": "odd.bin", "byteLength": len(data)}], "bufferViews": views, "accessors": accessors, "scene": 0,
           "scenes": [{"nodes": list(range(len(meshes)))}], "nodes": [{"name": m[0], "mesh": i} for i, m in enumerate(meshes)],
           "meshes": [{"primitives": [{"attributes": {"POSITION": i}, "material": 0}]} for i in range(len(meshes))],
           "materials": [{"name": "grey", "pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1}}}],
           "extensionsUsed": ["KHR_materials_clearcoat"]}, open("odd.gltf", "w"))
PY
expect 0 "$ffbake" odd.gltf -o w.ffm --patch-size 0.5 --rays 64 --no-cache --quiet --json
[ "$(grep -c 'warning: ' err.txt)" = 2 ] || fail "not a line a kind: $(cat err.txt)"
python3 - <<'PY' || fail "findings: $(cat out.txt)"
import json
found = {f["kind"]: f for f in json.load(open("out.txt"))["findings"]}
assert sorted(found) == ["duplicates", "not_modelled", "open_edges"], found
assert found["duplicates"]["count"] == 12 and found["open_edges"]["count"] == 4 and found["not_modelled"]["count"] == 24, found
for f in found.values():
    assert 0 < f["share"] <= 1 and f["share_of"] == "surface" and f["what"] and f["counted"], f
    assert all(len(p["at"]) == 3 and p["name"] and 0 < p["share"] <= 1 for p in f["places"]) and f["places"], f
    assert f["what"] in open("err.txt").read() or f["kind"] == "not_modelled", f
at, name = found["open_edges"]["places"][0]["at"], found["open_edges"]["places"][0]["name"]
assert at[0] == 4 and 1 <= at[1] <= 2 and "open crate" in name, (at, name)
PY
rm -f w.*
echo "ffbake: objects are chosen by name or refused"
