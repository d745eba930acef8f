#!/usr/bin/env bash
# Every reading of the paper's form at the paper's length (docs/results/paper-form.md): two suites, ten tasks, 20
# episodes in a row (initial states 0-19, seed 0), Clean and four scenarios at L5. What is done is not repeated. The
# outcome of every episode: OUT/READING.jsonl.
#   eval/conditions/paper_readings.sh OUT [READINGS...] [-- OPTIONS OF SWEEP...]
set -euo pipefail
out=${1:?OUT}
shift
readings=()
while (($#)) && [[ $1 != -- ]]; do readings+=("$1") && shift; done
(($#)) && shift
((${#readings[@]})) || readings=(command-1e-6 command-1e-5 command-1e-4 tracking-1e-6 tracking-1e-5 tracking-1e-4
  intent nominal_intent base null gain)

options_of() { # READING: preset and --set
  case $1 in
    command-* | tracking-*) echo "ours --set method.residual_scale=${1%%-*} --set method.learning_rate=${1#*-}" ;;
    intent) echo ours_intent ;;
    nominal_intent) echo "ours_nominal --set method.target=nominal_intent" ;;
    nominal_intent-*) echo "ours_nominal --set method.target=nominal_intent --set method.learning_rate=${1#*-}" ;;
    *) echo "$1" ;;
  esac
}

for reading in "${readings[@]}"; do
  # shellcheck disable=SC2046  # several words
  robostress sweep --no-report --quiet --suites tabletop_object,tabletop_goal --tasks all --severities 5 \
    --scenarios clean,heavy_payload,thermal_drift_stribeck,aged_transmission,aged_joint_uniform \
    --episodes 20 --seeds 0 --out "$out/$reading" "$@" --methods $(options_of "$reading")
  robostress store outcomes "$out/$reading" --out "$out/$reading.jsonl" >/dev/null
done
