#!/bin/bash
# nano-libero: demonstrations in LIBERO's forty tasks -> training -> one round of DAgger -> training goes on. Every stage
# leaves a mark and is not repeated; a training that was interrupted goes on from its checkpoint. Needs LIBERO's files:
# `robostress libero setup`.
#   server/training/nano_libero.sh BIN OUT    from the repository root; BIN: folder of the robostress programs
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,5s/^# \{0,1\}//p' "$0"
  exit 2
fi
bin=$1 out=$2 recipe=$(dirname "$0")/nano_libero.yaml
recording=(--suite libero --plain-pictures)
mkdir -p "$out"
# shellcheck source-path=SCRIPTDIR source=stages.sh
source "$(dirname "$0")/stages.sh"

record demos --stride 3 --episodes 25 --first-draw 1000 --seed 1
[[ -e $out/base/DONE ]] || "$bin/robostress-train" --recipe "$recipe" --data "$out/demos" --out "$out/base" --resume
dagger dagger "$out/base/nano.safetensors" --episodes 6 --first-draw 2000
[[ -e $out/round1/DONE ]] || "$bin/robostress-train" --recipe "$recipe" --data "$out/demos" --data "$out/dagger" \
  --init "$out/base/nano.safetensors" --set steps=4000 lr=0.0008 warmup=50 seed=42 --out "$out/round1" --resume
echo "weights: $out/round1/nano.safetensors"
