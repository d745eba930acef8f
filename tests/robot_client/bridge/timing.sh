#!/usr/bin/env bash
# Latency of the bridge, measured: bridge_timing against emulated_driver.py. Prints a Markdown table [ms].
#
#   tests/robot_client/bridge/timing.sh BUILD_DIR [SECONDS]      SECONDS of each rate, 5
set -euo pipefail
here=$(dirname "$(realpath "$0")")
bin=${1:?usage: timing.sh BUILD_DIR [SECONDS]} seconds=${2:-5}
folder=$(mktemp -d)
python3 "$here/emulated_driver.py" --socket "$folder/arm" >"$folder/driver" 2>&1 &
driver=$!
trap 'kill "$driver"; rm -rf "$folder"' EXIT
for _ in $(seq 100); do
  [[ -S $folder/arm ]] && break
  sleep 0.05
done
"$bin/test_bin/bridge_timing" --socket "$folder/arm" --robot "$here/five_servos.yaml" --seconds "$seconds"
