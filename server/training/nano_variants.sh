#!/bin/bash
# Base, DR and RobustVLA from the same weights: records clean and noisy demonstrations of the same initial states,
# then trains the three. Every stage leaves a mark and is not repeated; an interrupted training goes on.
#   server/training/nano_variants.sh BIN OUT    from the repository root; BIN: folder of the robostress programs
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,4s/^# \{0,1\}//p' "$0"
  exit 2
fi
bin=$1 out=$2 recipes=$(dirname "$0")
mkdir -p "$out"

record() {  # NAME ARGUMENTS...: one folder of shards
  [[ -e $out/$1.done ]] || { "$bin/robostress-record" --suite all --episodes 25 --first-draw 1000 --seed 1 \
    --out "$out/$1" --tag "$1" --workers 2 "${@:2}"; touch "$out/$1.done"; }
}
train() {  # NAME DATA: with a look at the development states on the way
  [[ -e $out/$1/DONE ]] || "$bin/robostress-train" --recipe "$recipes/nano_$1.yaml" --data "$out/$2" --out "$out/$1" \
    --resume --evaluate "$bin/robostress sweep --policies {weights} --suites tabletop_goal --scenarios clean \
--methods base --tasks all --episodes 1 --first-initial-state 40 --workers 1 --out {out} --no-report"
}

record demos
record dr_demos --execution-noise 0.05
train base demos
train dr dr_demos
train robust demos
"$bin/robostress" report --training "$out/base" --training "$out/dr" --training "$out/robust" --out "$out/training.html"
