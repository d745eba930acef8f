#!/bin/bash
# nano-libero: demonstrations in LIBERO's forty tasks -> training -> three rounds of DAgger, training going on after each.
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
recording=(--suite libero --plain-pictures)
last=base
for round in 1 2 3; do
  dagger "dagger$round" "$out/$last/nano.safetensors" --stride 3 --episodes 16 --first-draw "$((round + 1))000"
  demos+=(--data "$out/dagger$round")
  [[ -e $out/round$round/DONE ]] || "$bin/robostress-train" --recipe "$recipe" "${demos[@]}" \
    --init "$out/$last/nano.safetensors" --set steps=5000 lr=0.0008 warmup=50 "seed=$((round + 41))" --out "$out/round$round" --resume
  last=round$round
done
echo "weights: $out/$last/nano.safetensors"
