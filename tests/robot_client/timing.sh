#!/usr/bin/env bash
# Missed deadlines and lateness of the client's control thread: a rehearsal against a server of swaying joint
# targets, recorded as every run is. Load the machine as you like meanwhile. 100,000 ticks take 56 minutes.
#
#   tests/robot_client/timing.sh BUILD_DIR [TICKS [PRIORITY [OUT_DIR]]]      PRIORITY of SCHED_FIFO, 0: ordinary
set -euo pipefail
bin=${1:?usage: timing.sh BUILD_DIR [TICKS [PRIORITY [OUT_DIR]]]}
ticks=${2:-100000} priority=${3:-50} out=${4:-$(mktemp -d)/timing}
mkdir -p "$out"
"$bin/test_bin/joint_policy_server" >"$out/server.txt" &
server_pid=$!
trap 'kill "$server_pid"' EXIT
server=""
while [[ -z $server ]]; do
  sleep 0.1
  server=$(sed -n 's/^joint_policy_server: //p' "$out/server.txt")
done
"$bin/bin/robot_client" --bus rehearse --server "$server" --policy sway --instruction sway --camera base=synthetic \
  --camera wrist=synthetic --automatic --set episodes=1 --set "episode_s=$((ticks / 30 + 6))" \
  --set "realtime.priority=$priority" --out "$out/run" </dev/null
# Columns 4 and 5: from the deadline to the tick's start, and to the hand-over of its command [us].
awk -F, 'NR > 1 { ++n; if ($4 > wake) wake = $4; if ($5 > sent) sent = $5
                  for (i = 1; i <= 4; ++i) if ($5 > 100 * 10 ^ (i - 1)) ++late[i]; if ($5 > 33333) ++missed }
  END { printf "%d ticks: %d missed the next deadline; command later than 0.1 / 1 / 10 ms: %d / %d / %d; latest start %.2f ms, latest command %.2f ms\n",
               n, missed, late[1], late[2], late[3], wake / 1000, sent / 1000 }' "$out/run/ticks.csv"
