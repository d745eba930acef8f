#!/bin/bash
# nano-libero: demonstrations in LIBERO's forty tasks -> training -> six rounds of DAgger, training going on after each.
# Every stage leaves a mark and is not repeated; a training that was interrupted goes on from its checkpoint. Needs
# LIBERO's files: `robostress libero setup`.
#   server/training/nano_libero.sh BIN OUT    from the repository root; BIN: folder of the robostress programs
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,5s/^# \{0,1\}//p' "$0"
  exit 2
fi
bin=$1 out=$2 recipe=$(dirname "$0")/nano_libero.yaml
mkdir -p "$out"
# shellcheck source-path=SCRIPTDIR source=stages.sh
source "$(dirname "$0")/stages.sh"

# The long tasks of libero_10 need most and take longest; libero_object's are learned from few.
demos=()
for suite in libero_10:30 libero_goal:32 libero_spatial:32 libero_object:20; do
  recording=(--suite "${suite%:*}" --plain-pictures)
  record "demos_${suite%:*}" --stride 3 --episodes "${suite#*:}" --first-draw 1000 --seed 1
  demos+=(--data "$out/demos_${suite%:*}")
done
[[ -e $out/base/DONE ]] || "$bin/robostress-train" --recipe "$recipe" "${demos[@]}" --out "$out/base" --resume
train() {  # NUMBER [STEPS]: on all data so far
  [[ -e $out/round$1/DONE ]] || "$bin/robostress-train" --recipe "$recipe" "${demos[@]}" \
    --init "$last" --set "steps=${2:-5000}" lr=0.0008 warmup=50 "seed=$(($1 + 41))" --out "$out/round$1" --resume
  last=$out/round$1/nano.safetensors
}
explore() {  # NAME SUITE EPISODES FIRST_DRAW [OPTIONS OF RECORD...]
  recording=(--suite "$2" --plain-pictures)
  dagger "$1" "$last" --stride 3 --episodes "$3" --first-draw "$4" "${@:5}"
  demos+=(--data "$out/$1")
}
last=$out/base/nano.safetensors
for number in 1 2 3; do
  explore "dagger$number" libero 16 "$((number + 1))000"
  train "$number"
done
# libero_10 has learned least.
explore dagger4 libero 10 5000
explore dagger4_libero_10 libero_10 24 5500
train 4
explore dagger5 libero 6 6000
explore dagger5_libero_10 libero_10 36 6500
train 5
# And what still fails most.
explore dagger6 libero_spatial 14 7000
explore dagger6_libero_10 libero_10 12 7500
explore dagger6_hardest libero_10 24 7600 --tasks 2,3,4,8,9
train 6 8000
echo "weights: $last"
