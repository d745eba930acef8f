#!/usr/bin/env bash
# The reporting run of docs/results/winning-back.md, one method and seed: Clean, the seven scenarios and the four unseen
# conditions, initial states 20-39. What is done is not repeated. The outcome of every episode: OUT/METHOD-SEED/*.jsonl.
#   eval/conditions/reporting_run.sh METHOD SEED OUT [OPTIONS OF SWEEP...]
set -euo pipefail
method=${1:?METHOD} seed=${2:?SEED} out=${3:?OUT}
shift 3
here=$(dirname "$0")
suites=tabletop_spatial,tabletop_object,tabletop_goal,tabletop_long

play() { # NAME FIRST_STATE EPISODES OPTIONS...
  local run=$out/$method-$seed/$1 first=$2 episodes=$3
  shift 3
  robostress sweep --no-report --quiet --suites "$suites" --tasks all --severities 5 --first-initial-state "$first" \
    --episodes "$episodes" --methods "$method" --seeds "$seed" --out "$run" "$@"
  robostress store outcomes "$run" --out "$run.jsonl" >/dev/null
}

play main 20 20 "$@"
play stick 20 20 --scenarios aged_transmission --set sim.joint_errors.friction_law=stick "$@"
play payload 20 20 --scenarios heavy_payload --set sim.joint_errors.gravity_sign=payload "$@"
play velocity 20 20 --scenarios aged_joint_uniform --set sim.joint_errors.offset_mode=velocity "$@"
for k in 0 1 2 3; do
  play "wear$k" $((20 + 5 * k)) 5 --scenarios "$here/unseen/random_wear_$k.yaml" "$@"
done
