#!/usr/bin/env bash
# usage: ffchart_cli.sh FFCHART FFSCENE FOLDER : the command's page, table and answer; that they repeat; exit codes.
set -euo pipefail
ffchart=$1 ffscene=$2 folder=$3
. "${BASH_SOURCE[0]%/*}/command.sh"
"$ffscene" town --patches 2k -o town.glb --camera town.json >/dev/null
expect 0 "$ffchart" town.glb -o a --patch-size 1 --quick --observers 3 --target-error 50
grep -q '^cheapest with error <= 50 %: ' out.txt || fail "no answer: $(cat out.txt)"
for f in accuracy.html accuracy.csv speed-accuracy-sun-and-sky.svg speed-accuracy-lamps.svg; do [ -s "a/$f" ] || fail "no a/$f"; done
ls a/worlds/*.settings.json >/dev/null || fail "the answer is not beside the world"
cp a/accuracy.csv first.csv
expect 0 "$ffchart" town.glb -o a --patch-size 1 --quick --observers 3 --keep-settings --eyes town.json --json
grep -q '^cheapest with error <= 3 %: ' err.txt || fail "people are not told on stderr"
python3 - <<'PY' || fail "the JSON is wrong, or not what the table says"
import csv, json
text = open("out.txt").read()
document = json.loads(text, parse_constant=lambda c: 1 / 0)  # no NaN, no Infinity
assert text.count("\n") == 1 and "town.glb" in document["command"] and document["version"]
page = document["accuracy"]
settings = {s["setting"]: s for s in page["settings"]}
rows = list(csv.DictReader(open("a/accuracy.csv")))
assert len(rows) == sum(max(1, len(s["accuracy"])) for s in settings.values())
compared = 0
for row in rows:
    setting = settings[row["setting"]]
    accuracy = {a["light"]: a for a in setting["accuracy"]}.get(row["light"], {})
    for column, cell in row.items():
        if column == "knobs":
            assert cell == "; ".join(f"{k} = {v}" for k, v in setting["knobs"].items())
            continue
        value = {**setting, **accuracy}.get(column)
        if isinstance(value, bool): assert cell == str(int(value)), (column, cell, value)
        elif isinstance(value, float) or isinstance(value, int):
            assert float(cell) == value, (column, cell, value)
            compared += 1
        else: assert cell == (value or ""), (column, cell, value)
assert compared > 12 * len(rows), compared
assert [s["light"] for s in page["sources"]] == [a["light"] for a in page["settings"][0]["accuracy"]]
for split in page["sources"]:
    parts = {s["source"]: s for s in split["sources"]}
    assert {"all together", "patches and rows", "cut", "solver"} <= set(parts), parts
    default = next(a for a in settings["default"]["accuracy"] if a["light"] == split["light"])
    assert abs(parts["all together"]["rel_l2"] - default["rel_l2"]) < 0.01 * default["rel_l2"]
    assert parts["all together"]["rel_l2_error"] > 0
cheapest, best = page["answers"]
assert cheapest["at_most_rel_l2"] == 0.03 and cheapest["written"] is None
assert best["at_most_relight_ms"] == 1 and best["at_most_memory_mib"] == 256
rooms = [a for a in settings["default"]["accuracy"] if a["light"] == "one lamp group lit"]
assert rooms and 0 < rooms[0]["rel_l2_error"] < 0.05, "the lit room hangs on one observer"
assert "for one lamp group lit at " in page["facts"]["error"], page["facts"]["error"]
for answer in page["answers"]: assert answer["setting"] is None or answer["setting"] in settings
assert {"speed-accuracy-sun-and-sky", "speed-accuracy-lamps"} <= {c["id"] for c in page["charts"]}
seen = {s["light"]: s for s in page["seen"]}
assert {"sun and sky", "lamps"} <= set(seen), seen
for s in seen.values():
    assert bool(s["note"]) == (s["streamed"]["rel_l2"] is None), s
    if s["note"]: continue
    assert s["eyes"] > 0 and s["pixels"] > 100 and s["not_drawn"] < 0.01, s
    assert 0 < s["streamed"]["median"] < 0.3 and abs(s["streamed"]["energy"]) < 0.3 and s["full_solve"]["rel_l2"] > 0, s
assert any(t["id"] == "seen" for t in page["tables"])
assert page["tables"] and page["pictures"] and page["facts"]["seed"] == "1"
PY
python3 - <<'PY' || fail "the table is wrong"
import csv
rows = list(csv.DictReader(open("a/accuracy.csv")))
default = {r["light"]: r for r in rows if r["is_default"] == "1"}
assert {"sun and sky", "lamps"} <= set(default), default
for r in default.values():  # a small town: a few per cent end to end, far less of it from the run time
    assert 0 < float(r["rel_l2"]) < 0.15 and float(r["full_solve_rel_l2"]) < 0.02, r
    assert float(r["relight_ms"]) > 0 and float(r["bake_seconds"]) > 0
seed = [r for r in rows if r["setting"].startswith("seed") and r["light"] == "lamps"]
assert float(seed[0]["rel_l2"]) > float(default["lamps"]["rel_l2"]), "the baseline beats the default"
PY
python3 - <<'PY' || fail "two runs differ"
import csv
times = {"relight_ms", "relight_ms_error", "update_ms_per_tile", "memory_bytes", "bake_seconds", "on_front"}
read = lambda f: [{k: v for k, v in r.items() if k not in times} for r in csv.DictReader(open(f))]
a, b = read("first.csv"), read("a/accuracy.csv")
assert a == b, next((x, y) for x, y in zip(a, b) if x != y)
PY
# A world behind a web server: the answer goes where it can be written.
python3 -u -m http.server 0 --bind 127.0.0.1 --directory a/worlds >server.txt 2>/dev/null &
server=$!
trap 'kill $server' EXIT
for ((i = 0; i < 100; ++i)); do grep -q port server.txt && break; sleep 0.1; done
address=http://127.0.0.1:$(sed -E 's/.*port ([0-9]+).*/\1/' server.txt)
rm -f a/worlds/*.settings.json
world=cell1_rays4096_quanta512.ffm
FORMFIELD_CACHE=off expect 0 "$ffchart" town.glb -o remote --patch-size 1 --quick --observers 3 --target-error 50 --world "$address/$world"
if ! [ -s remote/cell1_rays4096_quanta512.settings.json ]; then ls remote/worlds/*.settings.json >/dev/null || fail "the answer is nowhere: $(cat out.txt)"; fi
FORMFIELD_CACHE=off expect 2 "$ffchart" town.glb -o x --world "$address/absent.ffm"
[ "$(wc -l <err.txt)" -eq 1 ] || fail "not one line: $(cat err.txt)"
expect 0 "$ffchart" --version
expect 0 "$ffchart" --help
expect 1 "$ffchart"
expect 1 "$ffchart" -o x
[ "$(wc -l <err.txt)" -eq 1 ] || fail "not one line: $(cat err.txt)"
expect 2 "$ffchart" absent.glb -o x
expect 2 "$ffchart" town.glb -o x --world absent.ffm
"$ffscene" box -o box.glb >/dev/null
expect 3 "$ffchart" box.glb -o x --world a/worlds/cell1_rays4096_quanta512.ffm
grep -q 'name the scene that the world was baked from' err.txt || fail "no remedy: $(cat err.txt)"
