#!/usr/bin/env bash
# Runs a command in a Debian of its own that has nothing but its base system: what a bare machine would say.
# shellcheck disable=SC2317  # traps and `declare -f` call what looks unreachable
set -euo pipefail

readonly suites=(bookworm trixie)
source_tree=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

help() {
  cat <<'TEXT'
Usage: deploy/bare_debian.sh [options] SUITE [options] [--] COMMAND [arguments]

Makes a bare Debian with debootstrap in a folder, copies this repository's HEAD to its /src, and runs COMMAND there.
SUITE is bookworm (Debian 12) or trixie (Debian 13). The exit status is that of COMMAND. Needs root.

  --root DIR     Make the root in DIR and leave it there; the next run with the same DIR goes on with it: packages,
                 /src/build and ccache are kept. Without it a root is made in $TMPDIR (/var/tmp) and removed.
  --keep         Leave the root where it was made, and say where.
  --debs GLOB    Copy no source. Install these .debs and what they depend on, then run COMMAND in /root.
                 May be given several times.
  --take PATH    Afterwards copy PATH of the root, relative to where COMMAND ran, into the current folder.
  --mirror URL   Debian mirror; the default is debootstrap's.
  -h, --help     This text.

Examples
  deploy/bare_debian.sh trixie -- ./run test
  deploy/bare_debian.sh bookworm --take runs/quick -- ./run bench
  deploy/bare_debian.sh bookworm --debs 'build/packages/*.deb' -- robostress sweep --quick
  deploy/bare_debian.sh trixie --root /var/tmp/trixie -- bash       look around; a second run is there at once

COMMAND has mounts and processes of its own: both are gone when it ends, however it ends. The network is the
machine's. Of the environment it sees TERM, the proxy variables and those that begin with ROBOSTRESS_.
TEXT
}

say() { printf 'bare_debian: %s\n' "$*" >&2; }

fail() {
  say "$*"
  exit 1
}

usage_error() {
  say "$* (see --help)"
  exit 2
}

# Sets suite, folder, keep, debs, take, mirror and command.
read_options() {
  suite='' folder='' keep=no debs=() take=() mirror='' command=()
  while (($# > 0)); do
    case $1 in
      -h | --help)
        help
        exit 0
        ;;
      --keep) keep=yes ;;
      --root | --debs | --take | --mirror)
        (($# > 1)) || usage_error "$1 needs a value"
        case $1 in
          --root) folder=$2 ;;
          --debs) add_debs "$2" ;;
          --take) take+=("$2") ;;
          --mirror) mirror=$2 ;;
        esac
        shift
        ;;
      --)
        command=("${@:2}")
        break
        ;;
      -*) usage_error "unknown option $1; what belongs to the command stands after --" ;;
      *)
        if [[ $suite ]]; then
          command=("$@")
          break
        fi
        suite=$1
        ;;
    esac
    shift
  done
  [[ $suite ]] || usage_error "no suite given; known are ${suites[*]}"
  [[ " ${suites[*]} " == *" $suite "* ]] || usage_error "unknown suite '$suite'; known are ${suites[*]}"
  ((${#command[@]} > 0)) || usage_error "no command given"
}

add_debs() {
  local found
  mapfile -t found < <(compgen -G "$1")
  ((${#found[@]} > 0)) || fail "--debs $1 matches no file"
  debs+=("${found[@]}")
}

check_machine() {
  ((EUID == 0)) || fail "this needs root: debootstrap makes files of root and mounts. Try sudo $0"
  command -v debootstrap >/dev/null || fail "no debootstrap in PATH: apt-get install debootstrap"
  command -v unshare >/dev/null || fail "no unshare in PATH: apt-get install util-linux"
  if ((${#debs[@]} == 0)); then
    git -C "$source_tree" rev-parse -q --verify HEAD >/dev/null \
      || fail "$source_tree is no git checkout with a commit: only what is committed is copied"
  fi
}

# A root that this script finished making says so in a file.
is_made() { [[ -f $1/etc/bare_debian ]]; }

# Sets root.
choose_root() {
  local parent=${TMPDIR:-/var/tmp}
  if [[ $folder ]]; then
    keep=yes
    mkdir -p "$folder"
    root=$(cd "$folder" && pwd)
    if is_made "$root"; then
      local made
      made=$(<"$root/etc/bare_debian")
      [[ $made == "$suite" ]] || fail "--root $folder holds $made, not $suite: give another folder"
      return
    fi
    [[ -z $(ls -A "$root") ]] || fail "--root $folder is neither empty nor a root that this script made"
    parent=$root
  fi
  local needed=12 free
  if ((${#debs[@]} > 0)); then needed=4; fi
  free=$(df --output=avail -BG "$parent" | tail -1 | tr -dc 0-9)
  ((free >= needed)) || fail "$parent has ${free} GB free, and the root may take $needed: choose another with --root or TMPDIR"
  if [[ ! $folder ]]; then
    root=$(mktemp -d "$parent/bare-$suite.XXXXXX")
    chmod 755 "$root" # the system's users enter it too: the folder is their /
    began=yes
  fi
}

# Only what this run began to make, and then only what nobody asked to keep.
remove_root() {
  if [[ ${began:-} ]] && { [[ $keep == no ]] || ! is_made "$root"; }; then
    rm -rf --one-file-system "$root" || say "$root could not be removed wholly"
  fi
}

# Its own mounts, since debootstrap leaves some when it fails.
make_root() {
  local log=$root.log start=$SECONDS
  began=yes
  say "making $suite in $root; log in $log"
  unshare --mount --propagation private \
    debootstrap --variant=minbase "$suite" "$root" ${mirror:+"$mirror"} >"$log" 2>&1 </dev/null \
    || fail "debootstrap failed; the end of its log: $(tail -3 "$log" | tr '\n' ' ')"
  rm -f "$log"
  printf '127.0.0.1 localhost\n::1 localhost ip6-localhost\n' >"$root/etc/hosts"
  echo force-unsafe-io >"$root/etc/dpkg/dpkg.cfg.d/bare_debian" # nobody mourns a root that a power cut broke
  printf '%s\n' "$suite" >"$root/etc/bare_debian"
  say "made $suite in $((SECONDS - start)) s"
}

# In a root that is used again only what changed since is written, so that a build in /src/build goes on where it was.
copy_tree() {
  local to=$root/src noted=$root/etc/bare_debian.commit old='' changed=() removed=() head
  head=$(git -C "$source_tree" rev-parse HEAD) # asked once: HEAD may move meanwhile
  if [[ -f $noted ]] && git -C "$source_tree" cat-file -e "$(<"$noted")^{commit}" 2>/dev/null; then
    old=$(<"$noted")
    mapfile -d '' -t removed < <(git -C "$source_tree" diff -z --name-only --no-renames --diff-filter=D "$old" "$head")
    mapfile -d '' -t changed < <(git -C "$source_tree" diff -z --name-only --no-renames --diff-filter=d "$old" "$head")
    (cd "$to" && rm -f -- "${removed[@]}")
  else
    rm -rf "$to"
    mkdir "$to"
  fi
  if [[ ! $old ]] || ((${#changed[@]} > 0)); then
    git -C "$source_tree" archive "$head" -- "${changed[@]}" | tar -x --no-same-owner --touch -C "$to"
  fi
  printf '%s\n' "$head" >"$noted"
  say "copied ${head:0:10} to /src"
}

# enter ROOT FOLDER COMMAND...: the mounts of a running system, then the command. Runs as the first process of its
# own process and mount namespaces.
enter() {
  local root=$1 folder=$2 device me
  shift 2
  read -r me _ </proc/self/stat # still the outer /proc: the number that the outer script can kill
  printf '%s\n' "$me" >"$root/run/bare_debian.pid"
  mount --rbind "$root" "$root" # "df /" needs a mount point
  mount -t proc proc "$root/proc"
  mount -t sysfs -o ro sysfs "$root/sys"
  mount -t tmpfs -o mode=755 dev "$root/dev"
  for device in null zero full random urandom tty; do
    touch "$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
  done
  mkdir "$root/dev/pts" "$root/dev/shm"
  mount -t devpts -o newinstance,ptmxmode=0666,mode=620 devpts "$root/dev/pts"
  mount -t tmpfs -o mode=1777 shm "$root/dev/shm"
  ln -s pts/ptmx "$root/dev/ptmx"
  ln -s /proc/self/fd "$root/dev/fd"
  ln -s fd/0 "$root/dev/stdin"
  ln -s fd/1 "$root/dev/stdout"
  ln -s fd/2 "$root/dev/stderr"

  local environment=(HOME=/root LANG=C.UTF-8 PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin) name
  for name in TERM http_proxy https_proxy no_proxy "${!ROBOSTRESS_@}"; do
    if [[ ${!name:-} ]]; then environment+=("$name=${!name}"); fi
  done
  # A script's background job ignores Ctrl-C; the command does not.
  # shellcheck disable=SC2016  # the inner shell expands these
  env -i --default-signal=INT,QUIT "${environment[@]}" \
    chroot "$root" sh -c 'cd "$1" && shift && exec "$@"' sh "$folder" "$@"
}

# run_inside FOLDER COMMAND...
run_inside() {
  rm -f "$root/run/bare_debian.pid"
  unshare --mount --propagation private --pid --fork --kill-child \
    bash -euo pipefail -c "$(declare -f enter); enter \"\$@\"" bare_debian "$root" "$@" <&0 &
  inside=$!
  local status=0
  wait "$inside" || status=$?
  # An interrupt ends the wait; the command has got it too and decides.
  while kill -0 "$inside" 2>/dev/null; do
    status=0
    wait "$inside" || status=$?
  done
  inside=''
  return "$status"
}

install_debs() {
  local start=$SECONDS
  rm -rf "$root/debs"
  mkdir "$root/debs"
  cp -- "${debs[@]}" "$root/debs/"
  run_inside /debs sh -c 'export DEBIAN_FRONTEND=noninteractive
    apt-get update -q && apt-get install -q -y --no-install-recommends ./*.deb' \
    || fail "the packages could not be installed; apt-get's message is above"
  say "installed ${#debs[@]} packages and what they need in $((SECONDS - start)) s"
}

leave() {
  local status=$?
  if [[ ${inside:-} ]]; then
    # unshare ignores signals; with its first process a namespace ends as a whole.
    kill -KILL "$(<"$root/run/bare_debian.pid")" || kill -KILL "$inside"
    wait "$inside" || true
  fi 2>/dev/null
  remove_root
  exit "$status"
}

main() {
  read_options "$@"
  check_machine
  trap leave EXIT
  trap : INT
  trap 'exit 143' TERM
  trap 'exit 129' HUP
  choose_root
  is_made "$root" || make_root
  cp -L /etc/resolv.conf "$root/etc/resolv.conf"

  local where=/src
  if ((${#debs[@]} > 0)); then
    where=/root
    install_debs
  else
    copy_tree
  fi

  local start=$SECONDS status=0 path
  run_inside "$where" "${command[@]}" || status=$?
  say "'${command[*]}' ended with $status after $((SECONDS - start)) s in $suite"
  for path in "${take[@]}"; do
    cp -a -- "$root$where/$path" . || fail "--take $path: the command left no such file in $where"
  done
  if [[ $keep == yes ]]; then say "the root is kept in $root"; fi
  exit "$status"
}

main "$@"
