#!/bin/bash
# nano-pi05: demonstrations -> training from nano's prefix -> one round of DAgger -> training goes on. Every stage
# leaves a mark and is not repeated; a training that was interrupted goes on from its checkpoint.
#   server/training/nano_pi05.sh BIN OUT    from the repository root; BIN: folder of the robostress programs
set -euo pipefail
if [[ $# -ne 2 ]]; then
  sed -n '2,4s/^# \{0,1\}//p' "$0"
  exit 2
fi
bin=$1 out=$2 recipe=$(dirname "$0")/nano_pi05.yaml
mkdir -p "$out"
server=
trap '[[ -z $server ]] || kill "$server" 2>/dev/null || true' EXIT

record() {  # NAME ARGUMENTS...: one folder of shards
  [[ -e $out/$1.done ]] || { "$bin/robostress-record" --suite all --out "$out/$1" --tag "$1" --workers 2 "${@:2}"; touch "$out/$1.done"; }
}

record demos --episodes 30 --first-draw 1000 --seed 1
"$bin/robostress-train" --recipe "$recipe" --data "$out/demos" --out "$out/first" --resume
if [[ ! -e $out/dagger.done ]]; then
  rm -f "$out/port"
  "$bin/robostress-serve" --policy "$out/first/nano.safetensors" --listen 127.0.0.1:0 --port-file "$out/port" &
  server=$!
  until [[ -s $out/port ]]; do kill -0 "$server"; sleep 0.2; done
  record dagger --server "127.0.0.1:$(cat "$out/port")" --policy "$out/first/nano.safetensors" --mix 0.3 --episodes 5 --first-draw 2000
fi
"$bin/robostress-train" --recipe "$recipe" --data "$out/demos" --data "$out/dagger" --init "$out/first/nano.safetensors" \
  --set graft= steps=5000 lr=0.0012 warmup=50 seed=22 --out "$out/second" --resume
echo "weights: $out/second/nano.safetensors"
