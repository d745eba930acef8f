#!/bin/bash
# Demonstrations -> training -> two rounds of DAgger -> training goes on. Every stage leaves a mark and is not repeated;
# a training that was interrupted goes on from its checkpoint.
#   server/training/nano.sh BIN OUT      BIN: folder of the robostress programs; OUT: folder for data and weights
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,4s/^# \{0,1\}//p' "$0"
  exit 2
fi
bin=$1 out=$2 recipe=$(dirname "$0")/nano.yaml
mkdir -p "$out"
# shellcheck source-path=SCRIPTDIR source=stages.sh
source "$(dirname "$0")/stages.sh"

train() {  # NAME ARGUMENTS...
  [[ -e $out/$1/DONE ]] || "$bin/robostress-train" --recipe "$recipe" --out "$out/$1" --resume "${@:2}"
}

record demos --episodes 40 --first-draw 1000
train base --data "$out/demos"
dagger dagger1 "$out/base/nano.safetensors" --episodes 15 --first-draw 2000
train round1 --data "$out/demos" --data "$out/dagger1" --init "$out/base/nano.safetensors" --steps 4000 --lr 0.0008
dagger dagger2 "$out/round1/nano.safetensors" --episodes 15 --first-draw 3000
train round2 --data "$out/demos" --data "$out/dagger1" --data "$out/dagger2" --init "$out/round1/nano.safetensors" \
  --steps 4000 --lr 0.0008
echo "weights: $out/round2/nano.safetensors"
