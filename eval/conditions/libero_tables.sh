#!/usr/bin/env bash
# The sweeps of docs/results/libero-tables.md: nano-libero on LIBERO's four suites, Clean and the seven scenarios at L5,
# stored states FIRST to FIRST + EPISODES - 1 in a row. METHOD: a preset, or `paper`, the paper's form in its best reading.
# What is done is not repeated. The outcome of every episode: OUT/METHOD-FIRST.jsonl.
#   eval/conditions/libero_tables.sh METHOD FIRST EPISODES OUT [OPTIONS OF SWEEP...]
set -euo pipefail
if (($# < 4)); then
  sed -n '2,5s/^# \{0,1\}//p' "$0"
  exit 2
fi
method=$1 first=$2 episodes=$3 out=$4
shift 4
preset=("$method")
[[ $method != paper ]] || preset=(ours --set method.residual_scale=command method.learning_rate=1e-5)
robostress sweep --no-report --quiet --suites libero_spatial,libero_object,libero_goal,libero_10 --tasks all --severities 5 \
  --first-initial-state "$first" --episodes "$episodes" --out "$out/$method-$first" --set sim.pictures=plain \
  "$@" --methods "${preset[@]}"
robostress store outcomes "$out/$method-$first" --out "$out/$method-$first.jsonl"
