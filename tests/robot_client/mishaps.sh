#!/usr/bin/env bash
# What the client does when something fails in mid-motion, measured: an emulated arm over UDP in real time, in
# a network namespace of its own. Prints a Markdown table. About two minutes; a program, not a test: its
# times depend on the machine.
#
#   unshare -rn tests/robot_client/mishaps.sh BUILD_DIR [OUT_DIR [ONLY]]   # ONLY: a pattern of names
set -euo pipefail
bin=${1:?usage: mishaps.sh BUILD_DIR [OUT_DIR [ONLY]]}
out=${2:-$(mktemp -d)}
client=${ROBOT_CLIENT:-$bin/bin/robot_client} emulator=${PIPER_EMULATOR:-$bin/bin/piper_emulator}
only=${3:-} policy=${JOINT_POLICY_SERVER:-$bin/test_bin/joint_policy_server}
ip link set lo up
ip route add 224.0.0.0/4 dev lo
mkdir -p "$out"

monotonic() { awk '{print $1}' /proc/uptime; } # [s], 10 ms

# run NAME ACT [client options]: ACT is evaluated in mid-motion, with $server_pid and $emulator_pid.
run() {
  local name=$1 act=$2 server="" client_pid
  shift 2
  [[ $name =~ $only ]] || return 0
  # shellcheck disable=SC2086  # several options
  ${server_in:-} "$policy" ${server_options:-} >"$out/$name.server" &
  server_pid=$!
  # shellcheck disable=SC2086  # several options
  "$emulator" --bus udp:239.74.163.2:43113 --profile used_one_year --seconds 60 ${emulator_options:-} \
    >"$out/$name.emulator" 2>&1 &
  emulator_pid=$!
  while [[ -z $server ]]; do
    sleep 0.1
    server=$(sed -n 's/^joint_policy_server: //p' "$out/$name.server")
  done
  sleep 1.5
  "$client" --bus udp:239.74.163.2:43113 --server "$server" --policy sway --instruction sway \
    --camera base=synthetic --camera "${wrist:-wrist=synthetic}" --automatic --set episodes=1 --set episode_s=9 \
    --out "$out/$name" "$@" >"$out/$name.txt" 2>&1 &
  client_pid=$!
  for _ in $(seq 100); do
    if grep -q RUN "$out/$name/events.jsonl" 2>/dev/null; then break; fi
    sleep 0.05
  done
  sleep 3.2
  local at
  at=$(monotonic)
  eval "$act"
  wait "$client_pid" || true
  kill -CONT "$server_pid" 2>/dev/null || true
  kill -9 "$server_pid" "$emulator_pid" 2>/dev/null || true
  wait "$server_pid" "$emulator_pid" 2>/dev/null || true
  report "$name" "$at"
}

# Times from the mishap on: to the state's change, to the last change of the command, to an arm at rest
# (no joint is further than 5 mrad from where it stays; a worn arm hunts by one or two). A mishap that the
# emulator makes happens when its first trace is in the record.
report() {
  local name=$1 at=$2 origin
  origin=$(sed -n 's/.*"monotonic_ns":\([0-9]*\).*/\1/p' "$out/$name/events.jsonl")
  awk -F, -v name="$name" -v at="$at" -v origin="$origin" '
    NR == 1 { for (i = 1; i <= NF; ++i) col[$i] = i; next }
    { t = $1; state = $col["state"]; line = ""
      for (j = 1; j <= 6; ++j) line = line "," $col["sent_J" j]
      if ($col["faults"] != 0 && !first_fault) first_fault = t
      if ($col["sequence"] != last_sequence) { if (!silent) fresh = t }
      else if (t - fresh > 0.02 && was_run) silent = 1
      last_sequence = $col["sequence"]
      if (was_run && state != "RUN" && !changed) { changed = t; to = state; cause = $col["cause"] }
      if (state == "RUN") was_run = 1
      if (over || !was_run) next
      if (changed && state == "ENABLED") { over = 1; next }
      if (line != last && line != ",,,,,,") moved = t
      if (line != ",,,,,,") last = line
      time[++n] = t
      for (j = 1; j <= 6; ++j) q[n, j] = $col["q_J" j] }
    END {
      mishap = at - origin / 1e9
      if (cause == "arm_fault" || cause == "arm_disabled") mishap = first_fault ? first_fault : changed
      if (cause == "arm_silent") mishap = fresh
      for (i = 1; i <= n; ++i)
        for (j = 1; j <= 6; ++j) { d = q[i, j] - q[n, j]; if (d > 0.005 || d < -0.005) still = time[i] }
      printf "| %s | %s (%s) | %.2f | %.2f | %s |\n", name, to, cause, changed - mishap,
             (moved > mishap ? moved - mishap : 0), silent ? "not seen" : sprintf("%.2f", (still > mishap ? still - mishap : 0)) }
    ' "$out/$name/ticks.csv"
}

echo "| mishap | state (cause) | state after [s] | command at rest after [s] | arm at rest after [s] |"
echo "|---|---|---:|---:|---:|"
# shellcheck disable=SC2016  # evaluated in run
{
  run server_killed 'kill -9 $server_pid'
  run server_hangs 'kill -STOP $server_pid'
  run arm_process_killed 'kill -9 $emulator_pid'
  run operator_holds 'kill -INT $client_pid'
  run operator_stops_twice 'kill -INT $client_pid; sleep 0.1; kill -INT $client_pid'
}
# A server on another host: a network namespace of its own behind a link that is cut.
unshare -n sleep infinity &
host=$!
sleep 0.3
ip link add arm0 type veth peer name srv0 netns "$host"
ip addr add 192.0.2.1/24 dev arm0
ip link set arm0 up
nsenter -t "$host" -n sh -c 'ip link set lo up; ip addr add 192.0.2.2/24 dev srv0; ip link set srv0 up'
# shellcheck disable=SC2016
{
  server_in="nsenter -t $host -n" server_options="--host 192.0.2.2" run link_cut 'ip link set arm0 down'
  ip link set arm0 up
  server_in="nsenter -t $host -n" server_options="--host 192.0.2.2" \
    run link_cut_for_1s 'ip link set arm0 down; sleep 1; ip link set arm0 up'
}
kill "$host"
wrist=wrist=synthetic,fault=unplug@4 run camera_unplugged :
emulator_options="--fault silent@6" run arm_silent :
emulator_options="--fault collision:J2@6" run arm_collision :
emulator_options="--fault driver-error:J3@6" run arm_driver_error :
emulator_options="--fault power-off:J5@6" run joint_power_lost :
echo "records: $out" >&2
