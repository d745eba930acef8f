#!/usr/bin/env bash
# Sets a SocketCAN interface up for a Piper: ./deploy/can0.sh [can0]. Needs root and iproute2.
set -euo pipefail
interface=${1:-can0}
((EUID == 0)) || exec sudo "$0" "$@"
ip link show "$interface" >/dev/null || {
  echo "can0.sh: no interface $interface; is the adapter plugged in (lsusb) and its driver loaded (modprobe gs_usb)?" >&2
  exit 1
}
ip link set "$interface" down
# After a bus-off the controller starts again by itself after 100 ms; the client holds and reports it.
ip link set "$interface" type can bitrate 1000000 restart-ms 100
ip link set "$interface" txqueuelen 128 up
ip -details -statistics link show "$interface"
