#!/bin/bash
# bare_debian_test.sh BARE_DEBIAN.SH: what the script refuses, and, as root, one run in a root that a stand-in for
# debootstrap makes of this machine's sh. The network is not used.
# shellcheck disable=SC2016  # the shell in the root expands what stands in single quotes
set -u
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
failed=0
mkdir -p "$work/tree/deploy" "$work/bin" "$work/tmp"
cp "$1" "$work/tree/deploy/bare_debian.sh"
script=$work/tree/deploy/bare_debian.sh
export TMPDIR=$work/tmp

# expect NAME EXIT SAID COMMAND...
expect() {
  local name=$1 code=$2 text=$3 said got
  shift 3
  said=$(cd "$work" && "$@" 2>&1 </dev/null)
  got=$?
  if [ "$got" = "$code" ] && [[ "$said" == *"$text"* ]]; then
    echo "ok   $name"
  else
    echo "FAIL $name: exit $got, said '$said'"
    failed=1
  fi
}

expect "help" 0 "deploy/bare_debian.sh trixie -- ./run test" "$script" --help
expect "no suite" 2 "no suite given" "$script"
expect "another suite" 2 "unknown suite 'sid'; known are bookworm trixie" "$script" sid -- true
expect "no command" 2 "no command given" "$script" trixie --keep
expect "an option's value is missing" 2 "--root needs a value" "$script" trixie --root
expect "an unknown option" 2 "unknown option --rot" "$script" --rot x trixie -- true
expect "no such package" 1 "--debs none/*.deb matches no file" "$script" trixie --debs 'none/*.deb' -- true
if ((EUID != 0)); then
  expect "no root" 1 "this needs root" "$script" trixie -- true
  exit "$failed"
fi

for tool in bash cat cmp cp df dirname git mkdir mktemp mount mv rm sh sleep tail tar touch tr unshare chroot env ln ls \
  chmod grep readlink ldd pgrep; do
  path=$(type -P "$tool") && ln -s "$path" "$work/bin/$tool"
done
export PATH=$work/bin
expect "no debootstrap" 1 "no debootstrap in PATH: apt-get install debootstrap" "$script" trixie -- true
cat >"$work/bin/debootstrap" <<'DEBOOTSTRAP'
#!/bin/bash
# debootstrap --variant=minbase SUITE ROOT [MIRROR]
set -e
[ "${4:-}" != http://127.0.0.1:9 ] || { echo "E: no mirror" >&2; exit 1; }
mkdir -p "$3"/{bin,etc/dpkg/dpkg.cfg.d,proc,sys,dev,root,run,lib64}
for tool in sh sleep; do
  program=$(command -v $tool)
  cp -L "$program" "$3/bin/$tool"
  for library in $(ldd "$program" | grep -o '/[^ ]*'); do
    mkdir -p "$3/$(dirname "$library")"
    cp -L "$library" "$3/$library"
  done
done
DEBOOTSTRAP
chmod +x "$work/bin/debootstrap"
if [ ! -e "$work/bin/git" ] || ! unshare --mount --pid --fork sh -c : 2>/dev/null; then
  echo "skip one run: it needs git, and leave to make mount namespaces"
  exit "$failed"
fi
expect "no commit" 1 "is no git checkout with a commit" "$script" trixie -- true
git -C "$work/tree" init -q
echo one >"$work/tree/file"
git -C "$work/tree" add .
git -C "$work/tree" -c user.name=t -c user.email=t@example.org commit -qm one

expect "the command's exit status" 7 "ended with 7" "$script" trixie -- sh -c 'exit 7'
expect "the tree, and not what is not committed" 0 "has one only" \
  "$script" trixie -- sh -c 'read -r a </src/file; echo "has $a only"; test "$PWD" = /src'
expect "a clean environment with ROBOSTRESS_" 0 "jobs 3, secret ." \
  env ROBOSTRESS_JOBS=3 SECRET=x "$script" trixie -- sh -c 'echo "jobs $ROBOSTRESS_JOBS, secret $SECRET."; test -d /proc/1'
expect "nothing stays" 0 "" test -z "$(ls -A "$work/tmp")"
expect "a mirror that does not answer" 1 "debootstrap failed; the end of its log: E: no mirror" \
  "$script" trixie --mirror http://127.0.0.1:9 -- true
rm -f "$work"/tmp/*.log

expect "a root that stays" 0 "the root is kept in $work/here" "$script" trixie --root here -- sh -c 'echo kept >note'
expect "the same root with another suite" 1 "holds trixie, not bookworm" "$script" bookworm --root here -- sh -c :
expect "a folder of something else" 1 "neither empty nor a root" "$script" trixie --root tree -- sh -c :
expect "which is left alone" 0 "one" cat tree/file
echo two >"$work/tree/file"
git -C "$work/tree" -c user.name=t -c user.email=t@example.org commit -qam two
expect "the same root again has the new tree" 0 "two" "$script" trixie --root here --take file -- sh -c 'read -r a <file; echo $a'
expect "what was taken" 0 "two" cat "$work/file"
expect "nothing to take" 1 "--take none: the command left no such file in /src" "$script" trixie --root here --take none -- sh -c :

df=$(readlink "$work/bin/df")
rm "$work/bin/df"
printf '#!/bin/bash\necho Avail\necho 1G\n' >"$work/bin/df"
chmod +x "$work/bin/df"
expect "no space" 1 "has 1 GB free" "$script" trixie -- sh -c :
rm "$work/bin/df"
ln -s "$df" "$work/bin/df"

# A command that is cut off takes its processes, mounts and root with it.
"$script" trixie -- sh -c 'echo started; sleep 98765' >"$work/out" 2>&1 </dev/null &
cut=$!
for _ in {1..200}; do
  if [[ $(cat "$work/out") == *started* ]]; then break; fi
  sleep 0.1
done
kill "$cut"
wait "$cut"
expect "a terminated run says so" 0 "" test "$?" = 143
expect "a terminated run leaves no root" 0 "" test -z "$(ls -A "$work/tmp")"
expect "a terminated run leaves no mount" 1 "" grep "$work" /proc/mounts
expect "a terminated run leaves no process" 1 "" pgrep -f "sleep 98765"
exit "$failed"
