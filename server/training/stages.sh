# shellcheck shell=bash disable=SC2154  # bin and out: see the next line
# What nano*.sh share; sourced with $bin and $out set, and $recording: options of `robostress record`, else the embedded
# suites. Every stage leaves a mark and is not repeated.
server=
[[ -v recording ]] || recording=(--suite all)
trap '[[ -z $server ]] || kill "$server" 2>/dev/null || true' EXIT

record() {  # NAME ARGUMENTS...: one folder of shards
  [[ -e $out/$1.done ]] || { "$bin/robostress-record" "${recording[@]}" --out "$out/$1" --tag "$1" --workers 2 "${@:2}"; touch "$out/$1.done"; }
}
dagger() {  # NAME WEIGHTS ARGUMENTS...: the policy drives in turns with the expert
  [[ ! -e $out/$1.done ]] || return 0
  rm -f "$out/port"
  "$bin/robostress-serve" --policy "$2" --listen 127.0.0.1:0 --port-file "$out/port" &
  server=$!
  until [[ -s $out/port ]]; do kill -0 "$server"; sleep 0.2; done
  record "$1" --server "127.0.0.1:$(cat "$out/port")" --policy "$2" --mix 0.5 "${@:3}"
  kill "$server"
  wait "$server" || true
  server=
}
