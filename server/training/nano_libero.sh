#!/bin/bash
# nano-libero: demonstrations in LIBERO's forty tasks -> training -> four rounds of DAgger, training going on after each.
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
# Rounds of DAgger: 16 episodes of every task; the fourth 10, and 24 more of libero_10, which learned least.
round() {  # NUMBER: training on all data so far
  [[ -e $out/round$1/DONE ]] || "$bin/robostress-train" --recipe "$recipe" "${demos[@]}" \
    --init "$last" --set steps=5000 lr=0.0008 warmup=50 "seed=$(($1 + 41))" --out "$out/round$1" --resume
  last=$out/round$1/nano.safetensors
}
last=$out/base/nano.safetensors
recording=(--suite libero --plain-pictures)
for number in 1 2 3; do
  dagger "dagger$number" "$last" --stride 3 --episodes 16 --first-draw "$((number + 1))000"
  demos+=(--data "$out/dagger$number")
  round "$number"
done
dagger dagger4 "$last" --stride 3 --episodes 10 --first-draw 5000
recording=(--suite libero_10 --plain-pictures)
dagger dagger4_libero_10 "$last" --stride 3 --episodes 24 --first-draw 5500
demos+=(--data "$out/dagger4" --data "$out/dagger4_libero_10")
round 4
echo "weights: $last"
