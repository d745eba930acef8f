#!/usr/bin/env bash
# The gates of the source, `./run check`; --help says which there are. Prints one line a gate.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
logs=$root/build/check
gates=(format shell links doxygen thread-safety warnings commands tidy asan tsan)
clang_format_major=14 # Debian 12's; another one breaks lines elsewhere

help() {
  cat <<'TEXT'
Usage: ./run check [GATE...] [--base REF | --all]

  Without a GATE all of them run, in this order:
  format          clang-format 14 has nothing to change
  shell           shellcheck finds nothing in any script
  links           every link of a page leads to a file or a heading, every file that a page names is there
  doxygen         the comments of the headers become pages in build/doxygen/html without a warning
  thread-safety   Clang's analysis of the mutexes and of what they guard; every mutex is named by an annotation
  warnings        everything builds with warnings as errors (preset ci)
  commands        the commands of the pages run (preset ci)
  tidy            clang-tidy finds nothing (.clang-tidy) in files that differ from REF (origin/main); --all: in any
  asan            the tests labelled asan, with the address and undefined behaviour sanitizers (preset asan)
  tsan            the tests labelled tsan, with the thread sanitizer (preset tsan)

  Each gate writes build/check/GATE.log. Exit status: 0 none failed; 1 some did; 2 wrong usage.
  The first three take seconds, doxygen and thread-safety minutes, the others an hour and more on two cores.
TEXT
}

usage() {
  printf 'check: %s\n' "$*" >&2
  printf 'check: the gates are %s; ./run check --help says what they ask\n' "${gates[*]}" >&2
  exit 2
}

# A gate returns 0 (ok), 1 (failed), or 77 (skipped) with the reason as its last line.
skip() {
  printf '%s\n' "$*"
  exit 77
}

build_with() { # PRESET TARGET...
  local preset=$1
  shift
  ROBOSTRESS_PRESET=$preset "$root/run" build "$@"
}

scripts() {
  git ls-files -co --exclude-standard | while IFS= read -r file; do
    [[ -f $file ]] || continue
    if [[ $file == *.sh ]] || head -n 1 "$file" | grep -aqE '^#!.*[/ ](ba|da)?sh( |$)'; then printf '%s\0' "$file"; fi
  done
}

gate_format() {
  local major
  major=$(clang-format --version | sed -n 's/.*version \([0-9]*\)\..*/\1/p')
  if [[ $major != "$clang_format_major" ]]; then
    skip "clang-format is version $major; the tree is formatted with $clang_format_major, Debian 12's"
  fi
  git ls-files -co --exclude-standard -z '*.h' '*.cc' '*.cu' | while IFS= read -r -d '' file; do
    if [[ -f $file ]]; then printf '%s\0' "$file"; fi
  done | xargs -0 -r -n 50 -P "$(nproc)" clang-format --dry-run --Werror
}

gate_shell() { scripts | xargs -0 -r shellcheck -x; }

gate_links() { tests/docs/links.py .; }

gate_doxygen() { doxygen docs/Doxyfile; }

# Of the build only its commands and its generated headers.
gate_thread_safety() {
  build_with "$preset" rs_proto rs_state_proto
  deploy/check/thread_safety.py "build/$preset"
}

gate_warnings() { build_with ci; }

gate_commands() { ROBOSTRESS_PRESET=ci "$root/run" test -R '^docs_'; }

gate_tidy() {
  local build=dev
  if [[ ${tidy[*]} == --all ]]; then build=ci; fi
  build_with "$build" rs_proto rs_state_proto
  deploy/check/tidy.py "build/$build" "${tidy[@]}"
}

sanitizer() { # PRESET: the tests that have its name as a label, and what they need
  build_with "$1" "$1_tests"
  ctest --preset "$1" -L "^$1\$" --parallel "$(nproc)"
}
gate_asan() { sanitizer asan; }
gate_tsan() { sanitizer tsan; }

main() {
  local chosen=() gate status failed=0 begin seconds log
  tidy=()
  while (($# > 0)); do
    case $1 in
      -h | --help)
        help
        return 0
        ;;
      --all) tidy=(--all) ;;
      --base)
        (($# > 1)) || usage "--base needs a commit or a branch"
        tidy=(--base "$2")
        shift
        ;;
      *)
        [[ " ${gates[*]} " == *" $1 "* ]] || usage "no gate is called '$1'"
        chosen+=("$1")
        ;;
    esac
    shift
  done
  ((${#chosen[@]} > 0)) || chosen=("${gates[@]}")
  preset=${ROBOSTRESS_PRESET:-ci}
  cd "$root"
  mkdir -p "$logs"
  for gate in "${chosen[@]}"; do
    log=$logs/$gate.log
    begin=$SECONDS
    status=0
    # A subshell of its own, in which -e holds: after || it would not.
    set +e
    (
      set -e
      "gate_${gate//-/_}"
    ) >"$log" 2>&1
    status=$?
    set -e
    seconds=$((SECONDS - begin))
    case $status in
      0) printf '%-14s %5d s  ok\n' "$gate" "$seconds" ;;
      77) printf '%-14s %5d s  skipped: %s\n' "$gate" "$seconds" "$(tail -n 1 "$log")" ;;
      *)
        failed=1
        printf '%-14s %5d s  failed: %s\n' "$gate" "$seconds" "${log#"$root"/}"
        tail -n 20 "$log" | sed 's/^/  /'
        ;;
    esac
  done
  return "$failed"
}

main "$@"
