# Sourced by the tests of commands: works in an empty $folder from here on.
rm -rf "$folder" && mkdir -p "$folder" && cd "$folder"
fail() { echo "FAILED: $*" >&2; exit 1; }
expect() {  # expect CODE command...: its output in out.txt and err.txt
  local want=$1 got=0; shift
  "$@" >out.txt 2>err.txt || got=$?
  [ "$got" = "$want" ] || fail "exit $got instead of $want: $* : $(tail -n 20 err.txt)"
  if [ "$want" != 0 ] && [ "$(wc -l <err.txt)" -gt 12 ]; then fail "more than one clear line: $(cat err.txt)"; fi
}
