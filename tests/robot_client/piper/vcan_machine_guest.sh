#!/bin/bash
# bash, since the shell of busybox prefers its own ip, tc and setpriv.
# /init of the machine that vcan_machine.sh boots: every case, a row of the table each on the second serial port.
/bin/busybox --install -s /bin
export PATH=/bin HOME=/tmp
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mkdir -p /dev/pts /dev/shm
mount -t devpts devpts /dev/pts
mount -t tmpfs shm /dev/shm
rm -f /bin/sudo
ip link set lo up
for module in can can-raw can-dev vcan vxcan slcan kvaser_pci sch_tbf; do modprobe "$module" || echo "no module $module"; done
rows=/dev/ttyS1
# The emulator runs on names of virtual interfaces only.
ip link set can1 name vcanpci

# row NAME PATTERN TEXT: right where the text matches.
row() {
  verdict="**wrong**"
  text=$(echo "$3" | sed 's/$/;/' | tr '\n|' ' /' | sed 's/[; ]*$//')
  echo "$text" | grep -Eq "$2" && verdict=right
  echo "| $1 | $text | $verdict |" >$rows
  [ "$verdict" = right ] || { echo "WRONG $1: wanted $2"; tail -n 30 /tmp/log.* 2>/dev/null; }
}
wanted() { echo "$1" | grep -Eq "$(cat /only)"; }
now() { cut -d' ' -f1 /proc/uptime; }
until_said() { # FILE PATTERN; gives up with the client
  for _ in $(seq 150); do
    grep -q "$2" "$1" 2>/dev/null && return 0
    [ -n "${client:-}" ] && [ ! -d "/proc/$client" ] && return 1
    sleep 0.1
  done
  return 1
}

# A machine in software that others slow down may not reach the run, or hold at once: four times more.
mission() {
  for _ in 1 2 3 4 5; do
    mission_once "$@"
    if [ -n "$at" ] || [ "${retry:-yes}" = no ]; then return; fi
  done
}
# An arm on $1, a policy, a client on $2 for $3 seconds; $4 is done 2 s after it runs.
mission_once() {
  rm -rf /tmp/out /tmp/log.* /tmp/typed
  at=""
  mkfifo /tmp/typed
  joint_policy_server >/tmp/log.policy 2>&1 &
  policy=$!
  piper_emulator --bus "can:$1" >/tmp/log.arm 2>&1 &
  arm=$!
  until_said /tmp/log.policy joint_policy_server:
  until_said /tmp/log.arm piper_emulator:
  sleep 1
  timeout 60 robot_client --bus "can:$2" --server "$(sed -n 's/^joint_policy_server: //p' /tmp/log.policy)" --policy sway \
    --instruction sway --camera base=synthetic --camera wrist=synthetic --set episodes=1 --set "episode_s=$3" --out /tmp/out \
    --without arm_hold_s --set control.watchdogs.arm_hold_s=0.3 --set control.watchdogs.arm_fault_s=1 \
    <>/tmp/typed >/tmp/log.client 2>&1 &
  client=$!
  exec 4<>/tmp/typed
  if until_said /tmp/out/events.jsonl origin; then
    echo enable >&4
    until_said /tmp/out/events.jsonl ENABLED && echo start >&4
    until_said /tmp/out/events.jsonl '"RUN"' && sleep 2
    if tail -n 1 /tmp/out/events.jsonl | grep -q '"RUN"'; then
      at=$(now)
      eval "$4"
      sleep $(($3 - 1))
    fi
    echo success >&4
    sleep 1
    echo quit >&4
  fi
  wait $client
  code=$?
  client=""
  kill -9 $policy $arm 2>/dev/null
  wait $policy $arm 2>/dev/null
}
# States that the client entered after $at: "HOLD (send_failed) after 0.13 s".
changes() {
  [ -n "$at" ] || { echo "not reached: five runs held before, the machine is too slow just now"; return; }
  origin=$(sed -n 's/.*"monotonic_ns":\([0-9]*\).*/\1/p' /tmp/out/events.jsonl)
  sed -n 's/.*"t":\([0-9.]*\).*"state":"\([A-Z]*\)","cause":"\([a-z_]*\)".*/\1 \2 \3/p' /tmp/out/events.jsonl |
    awk -v at="$at" -v origin="$origin" '{ t = $1 + origin / 1e9 - at; if (t > -0.02) printf "%s (%s) after %.2f s\n", $2, $3, t }' | head -n "${1:-2}"
}
said() { sed -n 's/^robot_client: //p' /tmp/log.client | tail -1 | cut -c1-330; }
# What can_watch on $1 noticed after $at, with its times.
# What lasted less than 70 ms, two ticks, is left out: a machine in software is late now and then.
noticed() {
  awk -v at="$at" '
    / / && /;/ { split($0, p, ";"); t = $1 - at; sub(/^[0-9.]* /, "", p[1]); time[++n] = t; what[n] = p[1] }
    END { for (i = 1; i <= n; ++i) {
      if (time[i] < -0.02 || (i < n && time[i + 1] - time[i] < 0.07) || what[i] == last) continue
      last = what[i]; printf "%s after %.2f s\n", what[i], time[i] } }' /tmp/log.watch
}
adapter() { # a serial adapter, bridged to bus $1; its interface in $serial
  rm -f /tmp/adapter && mkfifo /tmp/adapter
  serial_adapter ${1:+"$1"} </tmp/adapter >/tmp/log.adapter 2>&1 &
  adapter_pid=$!
  exec 3>/tmp/adapter
  until_said /tmp/log.adapter can
  serial=$(head -1 /tmp/log.adapter)
}
no_adapter() {
  exec 3>&-
  kill -9 $adapter_pid 2>/dev/null
  wait $adapter_pid 2>/dev/null
}
fresh_vcan() {
  ip link del vcan0 2>/dev/null
  ip link add vcan0 type vcan
}
as_nobody="setpriv --reuid 65534 --regid 65534 --clear-groups --bounding-set -net_admin"

if wanted "interface absent"; then
  at=$(now)
  robot_client --bus can:can9 --server 127.0.0.1:1 --policy sway --instruction sway --camera base=synthetic \
    --camera wrist=synthetic --out /tmp/absent >/tmp/log.client 2>&1
  row "interface absent" "there is no interface can9.*can0.sh can9" "$(said)"
fi
if wanted "interface down"; then
  fresh_vcan
  can_watch can:vcan0 --seconds 1 >/tmp/log.client 2>&1
  row "interface down" "interface vcan0 is down.*can0.sh vcan0" "$(sed 's/^can_watch: //' /tmp/log.client)"
fi
if wanted "can0.sh on vcan"; then
  fresh_vcan
  text=$(bash /deploy/can0.sh vcan0 2>&1)
  row "can0.sh on vcan" "takes no bit rate.*does not restart.*[<,]UP.*qlen 14" "$(echo "$text" | grep -E '^can0.sh|qlen' | cut -c1-150)"
fi
if wanted "can0.sh on a PCI card"; then
  text=$(bash /deploy/can0.sh can0 2>&1; bash /deploy/can0.sh vcanpci >/dev/null 2>&1)
  row "can0.sh on a PCI card (SJA1000)" "[<,]UP.*qlen 14.*restart-ms 100.*bitrate 1000000" \
    "$(echo "$text" | grep -E '^can0.sh|qlen|restart-ms|bitrate 1' | sed 's/^ *//' | cut -c1-150)"
fi
bash /deploy/can0.sh can0 >/dev/null 2>&1
bash /deploy/can0.sh vcanpci >/dev/null 2>&1

finished() {
  if [ -e /tmp/out/DONE ]; then
    echo "an episode of 5 s, $(tail -n +2 /tmp/out/ticks.csv | wc -l) ticks, $(sed -n 's/.*"missed[a-z_]*": *\([0-9]*\).*/\1/p' /tmp/out/timing.json | head -1) deadlines missed, exit $code"
  else
    echo "not finished, exit $code: $(tail -2 /tmp/log.client)"
  fi
}
if wanted "a run over vcan"; then
  fresh_vcan; ip link set vcan0 up
  mission vcan0 vcan0 5 ''
  row "a run over vcan0" "an episode.*exit 0" "$(finished)"
fi
if wanted "a run over two PCI cards"; then
  mission vcanpci can0 5 ''
  row "a run over two PCI cards (SJA1000)" "an episode.*exit 0" "$(finished)"
fi
if wanted "second sender before"; then
  fresh_vcan; ip link set vcan0 up
  (while true; do cansend vcan0 155#0000000000000000; sleep 0.1; done) &
  other=$!
  retry=no mission vcan0 vcan0 3 ''
  kill $other
  row "second sender before the start" "another sender commands this arm.*0x155" "$(said)"
fi
if wanted "second sender in mid-run"; then
  fresh_vcan; ip link set vcan0 up
  mission vcan0 vcan0 6 'cansend vcan0 155#0000000000000000'
  row "second sender in mid-run" "FAULT \(arm_fault\) after 0\.[01]" "$(changes 1)"
fi
if wanted "interface down in mid-run"; then
  fresh_vcan; ip link set vcan0 up
  mission vcan0 vcan0 6 'ip link set vcan0 down; sleep 0.5; ip link set vcan0 up'
  row "interface down for 0.5 s in mid-run, from the start of the command" "FAULT \(arm_fault\) after 0\.[0-3]" "$(changes 1)"
fi
if wanted "interface deleted in mid-run"; then
  fresh_vcan; ip link set vcan0 up
  mission vcan0 vcan0 6 'ip link del vcan0'
  row "interface deleted in mid-run, from the start of the command" "FAULT \(arm_fault\) after 0\.[0-3]" "$(changes 1)"
fi

# A device that takes nothing: a queue that lets one frame of 16 bytes go in 16 s.
hold="root tbf rate 8bit burst 16b limit 3200b"
if wanted "stalled in mid-run"; then
  ip link add vxcan0 type vxcan peer name vcanpeer
  ip link set vxcan0 txqueuelen 14 up; ip link set vcanpeer up
  # shellcheck disable=SC2016  # mission expands it, later
  mission vcanpeer vxcan0 7 'tc qdisc replace dev vxcan0 $hold; at=$(now)' # tc itself takes 0.1 s here
  ip link del vxcan0
  row "sending stalls in mid-run, samples go on (vxcan)" "HOLD \(send_failed\) after 0\.[12].*FAULT \(send_failed\) after 0\.[5-7]" "$(changes 2)"
fi
# stalled NAME INTERFACE: how soon commands are refused, how many frames wait after 2 s, and that it goes on.
stalled() {
  can_watch "can:$2" --seconds 8 >/tmp/log.watch 2>&1 &
  watch=$!
  sleep 3
  # shellcheck disable=SC2086  # several words
  tc qdisc replace dev "$2" $hold
  at=$(now)
  sleep 2
  waiting=$(tc -s qdisc show dev "$2" | sed -n 's/.*backlog [0-9]*b \([0-9]*\)p.*/\1/p')
  tc qdisc del dev "$2" root # what waited is lost, echoes with it
  wait $watch
  row "$1" "^active, refuses commands after -?0\.0.* after 2.*; [1-9] frames" "$(noticed; echo "$waiting frames waited after 2 s")"
}
if wanted "stalled with echo"; then
  stalled "a stall on a device with echo (SJA1000)" can0
fi
if wanted "stalled without echo"; then
  ip link add vxcan0 type vxcan peer name vxcan1; ip link set vxcan0 txqueuelen 14 up; ip link set vxcan1 up
  stalled "a stall on a device without echo (vxcan)" vxcan0
  ip link del vxcan0
fi

if wanted "can0.sh on slcan"; then
  adapter
  text=$(bash /deploy/can0.sh "$serial" 2>&1)
  row "can0.sh on slcan" "does not restart by itself.*[<,]UP.*qlen 14" "$(echo "$text" | grep -E '^can0.sh|qlen' | cut -c1-190)"
  no_adapter
fi
bus_off() { # NAME PATTERN [PREFIX]
  adapter
  bash /deploy/can0.sh "$serial" >/tmp/log.setup 2>&1
  $3 can_watch "can:$serial" --seconds 6 >/tmp/log.watch 2>&1 &
  watch=$!
  sleep 3
  at=$(now)
  echo off >&3
  wait $watch
  # shellcheck disable=SC2016  # the backticks are in the text
  row "$1" "$2" "$(noticed; grep -o 'type `[^`]*`' /tmp/log.watch | sort -u)"
  no_adapter
}
if wanted "bus-off with the right"; then
  bus_off "bus-off on slcan, with CAP_NET_ADMIN" "bus-off, refuses commands after 0\.0.*active, takes commands.* after (0\.[5-9]|1\.)"
fi
if wanted "bus-off without the right"; then
  bus_off "bus-off on slcan, without" "no right to restart after 0\.[56].*type .sudo ip link set [a-z0-9]* down && sudo ip link set" "$as_nobody"
fi
if wanted "bus-off in mid-run"; then
  fresh_vcan; ip link set vcan0 up
  adapter can:vcan0
  bash /deploy/can0.sh "$serial" >/tmp/log.setup 2>&1
  mission vcan0 "$serial" 7 'echo off >&3'
  row "bus-off in mid-run, arm behind a serial adapter" "FAULT \(arm_fault\) after 0\.[01]" "$(changes 1)"
  no_adapter
fi
if wanted "serial adapter stalls"; then
  adapter
  bash /deploy/can0.sh "$serial" >/tmp/log.setup 2>&1
  can_watch "can:$serial" --seconds 30 >/tmp/log.watch 2>&1 &
  watch=$!
  sleep 2
  at=$(now)
  echo stall >&3
  wait $watch
  row "nobody reads the terminal of slcan" "refuses commands after 0\.[01]" "$(noticed | head -2)"
  no_adapter
fi
sync
poweroff -f
