#!/usr/bin/env bash
# The client and the emulated arm on a real SocketCAN: boots a small virtual machine with Debian's kernel, whose
# CAN drivers this project's machines lack, and prints a table case x what happened. Not part of CI: a few
# minutes; its times depend on the machine.
#
#   tests/robot_client/piper/vcan_machine.sh BUILD_DIR [--only PATTERN] [--write README] [--keep DIR]
#
#   --only PATTERN   cases whose name matches
#   --write README   replaces the table between its marks
#   --keep DIR       the machine's files and console stay there
#
# Needs targets robot_client, piper_emulator, joint_policy_server, can_watch, serial_adapter in BUILD_DIR, and of
# Debian: qemu-system-x86 busybox-static iproute2 can-utils util-linux (apt-get install). The kernel is fetched with
# apt-get download (linux-image-amd64; the -cloud- kernel has no CAN); KERNEL_DEB names one that is there already.
# The machine is emulated in software and has no network; ACCEL=kvm uses /dev/kvm where it works.
set -euo pipefail
build=$(readlink -f "${1:?usage: vcan_machine.sh BUILD_DIR [--only PATTERN] [--write README] [--keep DIR]}")
shift
here=$(dirname "$(readlink -f "$0")")
only=. write="" keep=""
while (($#)); do
  case $1 in
    --only) only=${2:?--only needs a pattern} ;;
    --write) write=$(readlink -f "${2:?--write needs a file}") ;;
    --keep) keep=${2:?--keep needs a directory} ;;
    *) echo "vcan_machine.sh: option $1 is unknown; see the head of this file" >&2; exit 2 ;;
  esac
  shift 2
done
fail() { echo "vcan_machine.sh: $*" >&2; exit 2; }

programs=()
for tool in qemu-system-x86_64:qemu-system-x86 busybox:busybox-static ip:iproute2 tc:iproute2 cansend:can-utils candump:can-utils \
  setpriv:util-linux; do
  path=$(PATH=$PATH:/usr/sbin:/sbin command -v "${tool%%:*}") || fail "${tool%%:*} is missing: apt-get install ${tool##*:}"
  [[ $tool == qemu* || $tool == busybox* ]] || programs+=("$path")
done
for name in bin/robot_client bin/piper_emulator test_bin/joint_policy_server test_bin/can_watch test_bin/serial_adapter; do
  [[ -x $build/$name ]] || fail "$build/$name is missing: ninja -C $build ${name##*/}"
  programs+=("$build/$name")
done

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
root=$work/root
mkdir -p "$root"/{bin,proc,sys,dev,tmp,etc,lib64,deploy} "$work/kernel"

deb=${KERNEL_DEB:-}
if [[ -z $deb ]]; then
  package=$(apt-cache depends linux-image-amd64 | sed -n 's/.*Depends: \(linux-image-[0-9].*\)/\1/p' | head -1)
  [[ -n $package ]] || fail "apt-cache knows no linux-image-amd64: apt-get update"
  (cd "$work" && apt-get -q download "$package" >/dev/null) || fail "apt-get download $package failed"
  deb=$(ls "$work"/linux-image-*.deb)
fi
dpkg -x "$deb" "$work/kernel"
kernel=$(ls "$work"/kernel/boot/vmlinuz-*)
version=${kernel##*/vmlinuz-}
modules=$work/kernel/lib/modules/$version/kernel
for part in net/can drivers/net/can/dev drivers/net/can/slcan drivers/net/can/vcan.ko drivers/net/can/vxcan.ko \
  drivers/net/can/sja1000 net/sched/sch_tbf.ko; do
  mkdir -p "$root/lib/modules/$version/kernel/$(dirname "$part")"
  cp -r "$modules/$part" "$root/lib/modules/$version/kernel/$part" || fail "the kernel $version has no $part"
done
cp "$work/kernel/lib/modules/$version"/modules.{order,builtin} "$root/lib/modules/$version/"
busybox depmod -b "$root" "$version"

cp "$(command -v busybox)" "$root/bin/busybox"
cp "${programs[@]}" "$root/bin/"
cp "$here/../../deploy/can0.sh" "$root/deploy/"
# The programs' libraries under their own paths, so that the loader needs no configuration.
ldd "${programs[@]}" | awk '/=> \//{print $3} /^\t\/lib/{print $1}' | sort -u | while read -r library; do
  mkdir -p "$root$(dirname "$library")"
  cp -L "$library" "$root$library"
done
bash_path=$(command -v bash)
cp "$bash_path" "$root/bin/bash"
ldd "$bash_path" | awk '/=> \//{print $3}' | while read -r library; do cp -Ln "$library" "$root$library"; done
mkdir -p "$root/usr/bin"
ln -s ../../bin/busybox "$root/usr/bin/env"
cp "$here/vcan_machine_guest.sh" "$root/init"
printf '%s' "$only" >"$root/only"
(cd "$root" && find . | busybox cpio -o -H newc 2>/dev/null | gzip -1) >"$work/initramfs.gz"

accel=${ACCEL:-tcg}
: >"$work/rows"
# The SJA1000 controllers of two PCI cards on one emulated bus: can0 for the client, the other for the arm.
timeout 1800 nice -n "${NICE:-5}" qemu-system-x86_64 -accel "$accel" -cpu "${CPU:-max}" -smp 2 -m 2048 -nic none -display none -no-reboot \
  -kernel "$kernel" -initrd "$work/initramfs.gz" -append "console=ttyS0 quiet panic=-1" \
  -object can-bus,id=bus0 -device kvaser_pci,canbus=bus0 -device kvaser_pci,canbus=bus0 \
  -serial "file:$work/console" -serial "file:$work/rows" 2>"$work/qemu" || {
  tail -n 5 "$work/console" "$work/qemu" >&2
  fail "the machine did not end by itself"
}
if [[ -n $keep ]]; then mkdir -p "$keep" && cp "$work"/{console,rows,qemu} "$keep/"; fi
{
  echo "Debian's kernel $version, accelerator $accel."
  echo
  echo "| case | what happened | |"
  echo "|---|---|---|"
  tr -d '\r' <"$work/rows" | grep '^|' || true
} >"$work/table"
cat "$work/table"
if [[ -n $write ]]; then
  mark="<!-- vcan-machine -->"
  awk -v mark="$mark" -v table="$work/table" '
    $0 == mark && !seen { seen = 1; print; while ((getline line < table) > 0) print line; skip = 1; next }
    $0 == mark { skip = 0 }
    !skip' "$write" >"$work/written"
  cp "$work/written" "$write"
fi
grep -q '^|' "$work/rows" || { tail -30 "$work/console" >&2; fail "no case was run"; }
! grep -q '\*\*wrong\*\*' "$work/rows"
