#!/usr/bin/env bash
# Runs the first example of `robot_client --help` as it is written: it serves a policy of the source and rehearses.
# A person's orders come on standard input.
#   help_example.sh BIN_DIR OUT_DIR
set -euo pipefail
bin=$(realpath "${1:?usage: help_example.sh BIN_DIR OUT_DIR}") out=$(realpath -m "${2:?usage: help_example.sh BIN_DIR OUT_DIR}")
export PATH=$bin:$PATH OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
rm -rf "$out"
mkdir -p "$out"
cd "$out"
# From the first comment to the empty line, without comments; a line's end with \ goes on.
robot_client --help | awk '/# a rehearsal/ {on = 1} on && /^ *$/ {exit} on && !/^ *#/' >example.txt
grep -q 'robostress serve' example.txt
{
  sed -e '/robostress serve/q' example.txt
  # shellcheck disable=SC2016  # the script that is written expands it
  echo 'server=$!; trap "kill $server" EXIT'
  # The command's last line without a \ ends it; what a person types comes before it.
  echo '{ echo enable; echo start; sleep 4; echo success; echo quit; } |'
  sed -e '0,/robostress serve/d' example.txt
} >script.sh
bash -e script.sh
test -e runs/rehearsal/DONE
grep -q '"success":true' runs/rehearsal/episodes.jsonl
grep -qE '"predictions":[1-9]' runs/rehearsal/episodes.jsonl
grep -q '"failed_predictions":0,' runs/rehearsal/episodes.jsonl
# A policy of another robot is refused with what to do instead.
robostress-serve --policy nano --port-file port >serve.txt 2>&1 &
server=$!
trap 'kill $server' EXIT
for _ in $(seq 300); do
  [[ -s port ]] && break
  sleep 0.1
done
code=0
robot_client --server "127.0.0.1:$(cat port)" --policy nano --instruction "open the top drawer" \
  --camera base=synthetic --camera wrist=synthetic --out runs/nano </dev/null >nano.txt 2>&1 || code=$?
cat nano.txt
[[ $code == 2 ]] && grep -q "'nano' commands end-effector displacements, robot 'piper' takes joint targets" nano.txt && grep -q 'serve --policy nano-piper' nano.txt
