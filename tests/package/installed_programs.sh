#!/usr/bin/env bash
# installed_programs.sh SOURCE BUILD SCRATCH VERSION: installs every program of BUILD and tries what comes with it:
# no path of the source or the build, --version, data found beside the program, pages without warnings, completion.
set -euo pipefail
source_dir=$1 build=$2 scratch=$3 version=$4
failed=0
complain() {
  echo "FAILED: $*"
  failed=1
}

rm -rf "$scratch"
for component in evaluation worker robot-client calibration server; do
  cmake --install "$build" --prefix "$scratch/first" --strip --component "$component" >"$scratch.log" \
    || { tail -5 "$scratch.log"; exit 1; }
done
mv "$scratch/first" "$scratch/moved here" # nothing may remember where it was installed
prefix="$scratch/moved here"
export PATH="$prefix/bin:$PATH"

while IFS= read -r -d '' program; do
  name=$(basename "$program")
  for folder in "$source_dir" "$build" "$scratch/first"; do
    if strings -a "$program" | grep -F "$folder/"; then complain "$name names $folder"; fi
  done
  said=$("$program" --version) || complain "$name --version ends with $?"
  [[ $said == *"$version ("*")" ]] || complain "$name --version says '$said'"
  page="$prefix/share/man/man1/$name.1.gz"
  [[ -e $page ]] || complain "$name has no page"
  [[ -e "$prefix/share/bash-completion/completions/$name" ]] || complain "$name has no completion"
done < <(find "$prefix/bin" -type f -print0)
(($(find "$prefix/bin" -type f | wc -l) >= 25)) || complain "only these programs: $(ls "$prefix/bin")"

# Weights are found by the program's folder alone.
(cd / && robostress policy inspect nano) >"$scratch.inspect" 2>&1 || complain "policy inspect nano: $(cat "$scratch.inspect")"

if command -v groff >/dev/null; then
  for page in "$prefix"/share/man/man1/*; do
    warnings=$(gzip -dc "$page" | groff -man -Tascii -ww -b 2>&1 >/dev/null)
    [[ -z $warnings ]] || complain "$(basename "$page"): $warnings"
  done
else
  echo "no groff: pages are not checked for warnings"
fi
gzip -dc "$prefix/share/man/man1/robostress-sweep.1.gz" | grep -F '\fB\-\-scenarios\fR' >/dev/null \
  || complain "the page of sweep lacks --scenarios"

# completes PROGRAM WORDS...: what <TAB> behind the last word offers.
completes() {
  # shellcheck disable=SC2016  # the inner shell expands these
  bash -uc 'source "$0/share/bash-completion/completions/$1"
    COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
    $(complete -p "$1" | sed "s/.*-F \([^ ]*\) .*/\1/")
    printf "%s\n" "${COMPREPLY[@]}"' "$prefix" "$@"
}
expect() {
  local wanted=$1 offered
  shift
  offered=$(completes "$@")
  [[ $'\n'$offered$'\n' == *$'\n'"$wanted"$'\n'* ]] || complain "'$*<TAB>' does not offer $wanted but: $offered"
}
expect sweep robostress sw
expect --scenarios robostress sweep --sce
expect heavy_payload robostress sweep --scenarios hea
expect clean,heavy_payload robostress sweep --scenarios clean,hea
expect tabletop_goal robostress-sweep --suites tabletop_g
expect ours_following robostress-sweep --methods ours_f
expect verify robostress store ver
expect monitor robot_client mon
expect --once robot_client monitor --on
expect --policy robostress-serve --poli
expect nano-piper robostress serve --policy nano-p

[[ $failed -ne 0 ]] || echo "programs, data, pages and completion work from another folder"
exit "$failed"
