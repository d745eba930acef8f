#!/bin/bash
# sdk_conformance.sh EMULATOR [SCRIPT [ARGUMENT ...]]: the stock piper_sdk over python-can's
# udp_multicast against piper_emulator, in a network namespace whose multicast route is lo. SCRIPT:
# sdk_conformance.py, or sdk_demos.py with its arguments. Exit 77: skipped, with the reason.
# ROBOSTRESS_PIPER_SDK: checkout of github.com/agilexrobotics/piper_sdk (tested: 0.6.1).
# ROBOSTRESS_PYTHON_CAN: folder with python-can and msgpack where python3-can is not installed.
set -u
emulator=$(readlink -f "$1")
script=${2:-sdk_conformance.py}
here=$(dirname "$(readlink -f "$0")")
skip() { echo "skipped: $1"; exit 77; }

sdk=${ROBOSTRESS_PIPER_SDK:-}
[ -n "$sdk" ] || skip "ROBOSTRESS_PIPER_SDK names no checkout of github.com/agilexrobotics/piper_sdk"
[ -d "$sdk/piper_sdk" ] || skip "ROBOSTRESS_PIPER_SDK=$sdk holds no folder piper_sdk"
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH="$sdk${ROBOSTRESS_PYTHON_CAN:+:$ROBOSTRESS_PYTHON_CAN}"
python=/usr/bin/python3
"$python" -c 'import can, msgpack' 2>/dev/null ||
  skip "$python has no python-can with msgpack (Debian: python3-can; or ROBOSTRESS_PYTHON_CAN)"
unshare -rn true 2>/dev/null || skip "no network namespace (unshare -rn) on this system"

exec unshare -rn bash -c '
  ip link set lo up && ip route add 224.0.0.0/4 dev lo || exit 1
  exec "$@"' bash "$python" "$here/$script" "$emulator" "${@:3}"
