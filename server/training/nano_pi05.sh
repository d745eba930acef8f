#!/bin/bash
# nano-pi05: demonstrations -> training from nano's prefix -> one round of DAgger -> training goes on. Every stage
# leaves a mark and is not repeated; a training that was interrupted goes on from its checkpoint.
#   server/training/nano_pi05.sh BIN OUT    from the repository root; BIN: folder of the robostress programs
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,4s/^# \{0,1\}//p' "$0"
  exit 2
fi
bin=$1 out=$2 recipe=$(dirname "$0")/nano_pi05.yaml
mkdir -p "$out"
# shellcheck source-path=SCRIPTDIR source=stages.sh
source "$(dirname "$0")/stages.sh"

record demos --episodes 30 --first-draw 1000 --seed 1
[[ -e $out/first/DONE ]] || "$bin/robostress-train" --recipe "$recipe" --data "$out/demos" --out "$out/first" --resume
dagger dagger "$out/first/nano.safetensors" --episodes 5 --first-draw 2000
[[ -e $out/second/DONE ]] || "$bin/robostress-train" --recipe "$recipe" --data "$out/demos" --data "$out/dagger" \
  --init "$out/first/nano.safetensors" --set graft= steps=5000 lr=0.0012 warmup=50 seed=22 --out "$out/second" --resume
echo "weights: $out/second/nano.safetensors"
