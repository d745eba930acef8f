#!/usr/bin/env bash
# The sweeps of docs/results/libero-tables.md: nano-libero on LIBERO's four suites, stored states FIRST to FIRST + EPISODES
# - 1 in a row. METHOD: a preset; `paper`, the paper's form in its best reading; `gain_two_rows`, winning-back.md's control;
# `expert`, the script in place of the policy.
# PART: seven (Clean and the seven scenarios at L5), noise (each error alone), level_1 to level_4 (the seven at that level)
# or a scenario's name (it alone at L5). What is done is not repeated. The outcome of every episode:
# OUT/METHOD/PART-FIRST.jsonl, which eval/docs/libero_tables.py reads.
#   eval/conditions/libero_tables.sh METHOD PART FIRST EPISODES OUT [OPTIONS OF SWEEP...]
set -euo pipefail
if (($# < 5)); then
  sed -n '2,8s/^# \{0,1\}//p' "$0"
  exit 2
fi
method=$1 part=$2 first=$3 episodes=$4 out=$5
shift 5
preset=("$method")
case $method in
  paper) preset=(ours --set method.residual_scale=command --set method.learning_rate=1e-5) ;;
  gain_two_rows) preset=(smooth_fewer_rows --set method.gain=1.15) ;;
  expert) preset=(base --policies expert) ;;
esac
seven=heavy_payload,thermal_drift_stribeck,thermal_drift_backlash,aged_transmission
seven+=,aged_joint_uniform,aged_joint_shoulder,aged_joint_elbow
case $part in
  seven) conditions=(--scenarios "clean,$seven" --severities 5) ;;
  noise) conditions=(--scenarios "isolated_stribeck,isolated_gravity,isolated_backlash,isolated_compliance" --severities 5) ;;
  level_[1-4]) conditions=(--scenarios "$seven" --severities "${part#level_}") ;;
  *) conditions=(--scenarios "$part" --severities 5) ;;
esac
run=$out/$method/$part-$first
tasks=(--suites "libero_spatial,libero_object,libero_goal,libero_10" --tasks all)
[[ " $* " != *" --suites "* && " $* " != *" --tasks "* ]] || tasks=()  # a part, to try it: both are the caller's
robostress sweep --no-report --quiet "${tasks[@]}" "${conditions[@]}" \
  --first-initial-state "$first" --episodes "$episodes" --out "$run" --set sim.pictures=plain "$@" --methods "${preset[@]}"
[[ " $* " == *" --dry-run "* ]] || robostress store outcomes "$run" --out "$run.jsonl"
