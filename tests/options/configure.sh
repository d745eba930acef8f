#!/usr/bin/env bash
# configure.sh SOURCE SCRATCH [CMake arguments...]: configures a build without each part that can be
# left out, and one without all of them. Each must configure and lose the targets that go with the
# part, and keep its neighbours. Compiles nothing.
set -euo pipefail
source_dir=$1 scratch=$2
shift 2

# option, a program and a test that go with it, a target that stays
parts="
LIBERO         robostress-replay      libero_task_test      robostress-worker
OPENPI         robostress-tokenize    openpi_network_test   robostress-policy
CLUSTER        robostress-grid-job    eval_slurm_test       robostress-sweep
ROBOT_CLIENT   robot_client           piper_arm_test        robostress-record-to-rig
"
failed=0
complain() { echo "FAILED: $*"; failed=1; }

configure() {  # FOLDER options...
  local folder=$scratch/$1
  shift
  rm -rf "$folder"
  cmake -G Ninja -S "$source_dir" -B "$folder" "$@" > "$folder.log" 2>&1 || { tail -30 "$folder.log"; return 1; }
  ninja -C "$folder" -t targets all > "$folder.targets"
  ctest --test-dir "$folder" -N >> "$folder.targets"
}
has() { grep -qE "^$2: phony$|^ *Test +#[0-9]+: $2\$" "$scratch/$1.targets"; }  # a target or a test

mkdir -p "$scratch"
all_off=()
configure with "$@" || { echo "FAILED: all parts ON do not configure"; exit 1; }
while read -r part program test stays; do
  [ -n "$part" ] || continue
  all_off+=("-DROBOSTRESS_$part=OFF")
  configure "without-$part" "$@" "-DROBOSTRESS_$part=OFF" || { complain "ROBOSTRESS_$part=OFF does not configure"; continue; }
  for target in "$program" "$test"; do
    has with "$target" || complain "$target is neither a target nor a test even with every part"
    if has "without-$part" "$target"; then complain "ROBOSTRESS_$part=OFF still builds $target"; fi
  done
  has "without-$part" "$stays" || complain "ROBOSTRESS_$part=OFF loses $stays"
done <<< "$parts"
if configure without-all "$@" "${all_off[@]}"; then
  while read -r part program test stays; do
    [ -n "$part" ] || continue
    for target in "$program" "$test"; do
      if has without-all "$target"; then complain "all parts OFF still build $target"; fi
    done
    has without-all "$stays" || complain "all parts OFF lose $stays"
  done <<< "$parts"
else
  complain "all parts OFF do not configure"
fi
[ "$failed" -ne 0 ] || echo "every part can be left out, and all together"
exit "$failed"
