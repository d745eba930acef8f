#!/usr/bin/env bash
# A small set of taught demonstrations, to train on: the scripted expert's paths as the hand that guides an
# emulated arm in teaching mode, recorded by robot_client teach in real time. About 20 s an episode.
#
#   unshare -rn tests/robot_client/teach/taught_set.sh BUILD_DIR OUT_DIR [EPISODES]
set -euo pipefail
bin=${1:?usage: taught_set.sh BUILD_DIR OUT_DIR [EPISODES]}/bin out=${2:?OUT_DIR} episodes=${3:-6}
bus=udp:239.74.163.2:43113
ip link set lo up
ip route add 224.0.0.0/4 dev lo
mkdir -p "$out"
"$bin/robostress-piper-worker" record --arm new --task open_drawer --episodes "$episodes" --out "$out/expert.safetensors"

# Four targets of every frame are the expert's path at 30 Hz. Prints each episode's initial state.
python3 - "$out" >"$out/states" <<'PYTHON'
import json, struct, sys
out = sys.argv[1]
with open(out + "/expert.safetensors", "rb") as file:
    size = struct.unpack("<Q", file.read(8))[0]
    header = json.loads(file.read(size))
    body = file.read()
def tensor(name, kind, width):
    begin, end = header[name]["data_offsets"]
    values = struct.unpack("<%d%s" % ((end - begin) // width, kind), body[begin:end])
    return values
actions, number = tensor("actions", "f", 4), tensor("episode", "q", 8)
start = 3.0  # of the arm's time: until then the hand rests at the first point
for state in sorted(set(number)):
    rows = [actions[(frame * 50 + k) * 7 : (frame * 50 + k) * 7 + 7]
            for frame, n in enumerate(number) if n == state for k in range(4)]
    with open("%s/hand_%d.csv" % (out, state), "w") as file:
        file.write("t,J1,J2,J3,J4,J5,J6,opening\n")
        for i, row in enumerate(rows):
            file.write("%.4f," % (start + i / 30) + ",".join("%.6f" % x for x in row) + "\n")
    print(state, len(rows))
PYTHON

while read -r state rows; do
  rm -f "$out/in" "$out/place" "$out/log"
  mkfifo "$out/in" "$out/place"
  "$bin/piper_emulator" --bus $bus --task open_drawer --teach 0 --hand "$out/hand_$state.csv" --views "$out/view" \
    --view-size 128 <"$out/place" >"$out/emulator.txt" &
  emulator=$!
  exec 4>"$out/place"
  echo "place $state" >&4
  "$bin/robot_client" teach --by hand --bus $bus --instruction "open the top drawer" --out "$out/set" \
    --camera base=mapped:"$out/view.base" --camera wrist=mapped:"$out/view.wrist" \
    --set realtime.priority=0 --set realtime.lock_memory=false --set control.watchdogs.arm_hold_s=0.2 \
    <"$out/in" >"$out/log" &
  client=$!
  exec 3>"$out/in"
  ticks() { cat "$out"/set/runs/*/ticks.csv.partial 2>/dev/null | wc -l; }
  until [[ $(ticks) -ge 20 ]]; do sleep 0.05; done
  echo record >&3
  until [[ $(ticks) -ge $((rows + 75)) ]]; do sleep 0.05; done
  echo success >&3
  until grep -Eq 'saved' "$out/log"; do sleep 0.05; done
  grep -E 'saved' "$out/log"
  echo quit >&3
  exec 3>&- 4>&-
  wait $client
  kill $emulator
  wait $emulator || true
  grep "done" "$out/emulator.txt" || echo "the drawer did not open in state $state"
done <"$out/states"
