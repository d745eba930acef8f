#!/usr/bin/env bash
# Sets a CAN interface up for a Piper: ./deploy/can0.sh [can0]. Needs root (asks sudo) and iproute2.
# Sets what the device can, says what it cannot, and leaves the interface up; exits with 1 when that fails.
set -uo pipefail
interface=${1:-can0}
((EUID == 0)) && as_root=() || as_root=(sudo)
say() { echo "can0.sh: $*" >&2; }
# The kernel's words for a refusal, or nothing.
try() { "${as_root[@]}" ip link set "$interface" "$@" 2>&1; }

if ! ip link show "$interface" >/dev/null 2>&1; then
  say "there is no interface $interface; is the adapter plugged in (lsusb) and its driver loaded (sudo modprobe gs_usb, or slcand for a serial adapter)?"
  exit 1
fi
if ! refusal=$(try down); then
  say "taking $interface down failed ($refusal); has this user the right?"
  exit 1
fi
# One option at a time: a device that refuses one of them refuses the whole command.
if ! refusal=$(try type can bitrate 1000000); then
  say "$interface takes no bit rate from the kernel ($refusal); a serial adapter must have it from slcand -s8 (1 Mbit/s), a vcan needs none"
fi
# After a bus-off the controller starts again by itself after 100 ms.
if ! refusal=$(try type can restart-ms 100); then
  say "$interface does not restart by itself after a bus-off ($refusal); robot_client takes it down and up where it has the right (CAP_NET_ADMIN), else type: sudo ip link set $interface down && sudo ip link set $interface up"
fi
# 0.1 s of commands at 30 Hz, 15 frames, must not fit, so that an adapter that sends nothing is noticed
# and its old commands are not obeyed late; the 13 questions of a start must.
if ! refusal=$(try txqueuelen 14); then
  say "$interface keeps its transmit queue ($refusal); robot_client watches what waits in it"
fi
if ! refusal=$(try up); then
  say "$interface does not come up ($refusal); a controller without a bit rate does not: see above"
  exit 1
fi
ip -details -statistics link show "$interface"
