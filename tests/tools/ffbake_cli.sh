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
echo "ffbake: objects are chosen by name or refused"
