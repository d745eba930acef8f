#!/bin/bash
# can0_script_test.sh CAN0.SH: the script against an `ip` that refuses what some adapters refuse.
set -u
script=$(readlink -f "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
failed=0
cat >"$work/ip" <<'IP'
#!/bin/bash
# Notes what was set; refuses what $REFUSES (a pattern) matches, as the kernel does.
if [ "$1" = link ] && [ "$2" = set ]; then
  shift 3
  if [ -n "${REFUSES:-}" ] && [[ "$*" =~ $REFUSES ]]; then
    echo "RTNETLINK answers: Operation not supported" >&2
    exit 2
  fi
  echo "$*" >>"$LOG"
  exit 0
fi
[[ "$*" != *nosuch* ]]
IP
printf '#!/bin/bash\nexec "$@"\n' >"$work/sudo"
chmod +x "$work/ip" "$work/sudo"
export LOG=$work/log PATH="$work:$PATH"

# expect NAME REFUSES INTERFACE EXIT SET SAID: what was set, line by line joined by ';'.
expect() {
  : >"$LOG"
  local said code set
  said=$(REFUSES=$2 "$script" "$3" 2>&1)
  code=$?
  set=$(paste -sd';' "$LOG")
  if [ "$code" = "$4" ] && [ "$set" = "$5" ] && [[ "$said" == *"$6"* ]]; then
    echo "ok   $1"
  else
    echo "FAIL $1: exit $code, set '$set', said '$said'"
    failed=1
  fi
}

expect "an adapter with everything" "" can0 0 \
  "down;type can bitrate 1000000;type can restart-ms 100;txqueuelen 14;up" ""
expect "no restart after a bus-off (gs_usb of Debian 12)" "restart-ms" can0 0 \
  "down;type can bitrate 1000000;txqueuelen 14;up" "does not restart by itself after a bus-off"
expect "no options at all (slcan, vcan)" "type can" can1 0 "down;txqueuelen 14;up" "slcand -s8"
expect "no queue length" "txqueuelen" can0 0 \
  "down;type can bitrate 1000000;type can restart-ms 100;up" "keeps its transmit queue"
expect "does not come up" "^up" can0 1 \
  "down;type can bitrate 1000000;type can restart-ms 100;txqueuelen 14" "does not come up"
expect "no rights" "^down" can0 1 "" "has this user the right"
expect "no interface" "" nosuch0 1 "" "there is no interface nosuch0"
exit $failed
