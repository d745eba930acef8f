#!/usr/bin/env bash
# The reporting run of docs/results/winning-back.md of one method: Clean, the seven scenarios and the four unseen
# conditions, initial states 20-39; with --first-seed Clean and the seven alone, states 20-26; with --unseen the four
# alone. What is done is not repeated. The outcome of every episode: OUT/METHOD/*.jsonl. METHOD may be NAME:PRESET, a
# preset with options.
#   eval/conditions/reporting_run.sh METHOD OUT [--first-seed | --unseen] [OPTIONS OF SWEEP...]
set -euo pipefail
method=${1:?METHOD} out=${2:?OUT}
shift 2
row=${method%%:*} preset=${method#*:}
part=all
case ${1:-} in --first-seed | --unseen) part=$1 && shift ;; esac
here=$(dirname "$0")
suites=tabletop_spatial,tabletop_object,tabletop_goal,tabletop_long

play() { # NAME SEED FIRST_STATE EPISODES OPTIONS...
  local run=$out/$row/$1 seed=$2 first=$3 episodes=$4
  shift 4
  robostress sweep --no-report --quiet --suites "$suites" --tasks all --severities 5 --first-initial-state "$first" \
    --episodes "$episodes" --methods "$preset" --seeds "$seed" --out "$run" "$@"
  robostress store outcomes "$run" --out "$run.jsonl" >/dev/null
}

in_three() { # NAME OPTIONS...: seed 0 for states 20-26, 1 for 27-33, 2 for 34-39
  local name=$1
  shift
  play "$name-0" 0 20 7 "$@"
  play "$name-1" 1 27 7 "$@"
  play "$name-2" 2 34 6 "$@"
}

case $part in
  --first-seed)
    play seven-0 0 20 7 "$@"
    exit
    ;;
  all) in_three seven "$@" ;;
esac
in_three stick --scenarios aged_transmission --set sim.joint_errors.friction_law=stick "$@"
in_three payload --scenarios heavy_payload --set sim.joint_errors.gravity_sign=payload "$@"
in_three velocity --scenarios aged_joint_uniform --set sim.joint_errors.offset_mode=velocity "$@"
for k in 0 1 2 3; do
  play "wear-$k" $((k % 3)) $((20 + 5 * k)) 5 --scenarios "$here/unseen/random_wear_$k.yaml" "$@"
done
