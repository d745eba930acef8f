#!/usr/bin/env bash
# Makes an archive that runs where it is unpacked, without root and without packages: the programs of a finished build,
# the libraries that they need (all but libc's), and a software renderer.
set -euo pipefail

if (($# != 3)); then
  printf 'Usage: cmake/make_archive.sh BUILD_DIR NAME OUT_DIR: makes OUT_DIR/NAME.tar.gz\n' >&2
  exit 2
fi
build=$1 name=$2 out=$3
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
stage=$work/$name
log=$out/$name.log

fail() {
  printf 'make_archive: %s\n' "$*" >&2
  exit 1
}

mkdir -p "$out"
for component in evaluation worker robot-client calibration server; do
  cmake --install "$build" --prefix "$stage" --strip --component "$component" >"$log" || fail "see $log"
done
rm -rf "$stage/lib/systemd"

# LibTorch and Ceres get the same OpenBLAS, whose threads OpenMP controls.
machine=$(dirname "$(ldconfig -p | awk '$1 == "libEGL.so.1" {print $NF; exit}')")
if [[ -d $machine/openblas-openmp ]]; then export LD_LIBRARY_PATH=$machine/openblas-openmp; fi

# Files that a program or library needs, as "soname path"; libc's own are the machine's.
needs() {
  ldd "$@" | awk '$2 == "=>" && $3 == "not" {print $1, "-"} $2 == "=>" && $3 ~ /^\// {print $1, $3}' | sort -u \
    | grep -vE '^(libc|libm|libdl|libpthread|librt|libresolv|libutil|libnsl|libanl|libmvec|ld-linux[^ ]*)\.so'
}

# What is not linked but loaded: Mesa behind EGL, and its software renderer.
egl=$machine/libEGL_mesa.so.0 renderer=$machine/dri/swrast_dri.so
[[ -e $egl ]] || fail "no $egl: apt-get install libegl-mesa0"
[[ -e $renderer ]] || fail "no $renderer: apt-get install libgl1-mesa-dri"
needs "$stage"/bin/* "$egl" "$renderer" >"$work/needs"
if missing=$(awk '$2 == "-" {print $1}' "$work/needs") && [[ $missing ]]; then fail "not found: $missing"; fi
mkdir -p "$stage/lib/dri" "$stage/share/glvnd/egl_vendor.d"
cp -L "$egl" "$stage/lib/"
cp -L "$renderer" "$stage/lib/dri/"
cp /usr/share/glvnd/egl_vendor.d/50_mesa.json "$stage/share/glvnd/egl_vendor.d/"
while read -r soname path; do
  cp -L "$path" "$stage/lib/$soname"
done <"$work/needs"

# Who made the libraries, and under which terms they go on.
mkdir -p "$stage/share/doc/libraries"
{ awk '{print $2}' "$work/needs"; printf '%s\n' "$egl" "$renderer"; } | xargs -r readlink -f | sort -u >"$work/files"
# A library is listed under /lib or /usr/lib; dpkg-query fails for the other.
sed 's,^/usr,,' "$work/files" | cat - "$work/files" | { xargs -r dpkg-query -S 2>/dev/null || true; } | cut -d: -f1 | sort -u \
  >"$work/packages"
while read -r package; do
  if [[ -e /usr/share/doc/$package/copyright ]]; then cp -L "/usr/share/doc/$package/copyright" "$stage/share/doc/libraries/$package"; fi
done <"$work/packages"

cat >"$stage/README" <<TEXT
$name: unpack it anywhere and run bin/robostress help. Nothing is installed; remove the folder and it is gone.
It needs Linux on x86-64 with glibc $(ldd --version | awk 'NR == 1 {print $NF}') or newer. Cameras are drawn in software.
man -M share/man robostress-sweep; source share/bash-completion/completions/robostress
share/doc/libraries has the licenses of the libraries in lib/.
TEXT

# The same bytes for the same files: names in order, no owners, the time of the sources' last commit.
time=$(git -C "$(dirname "$0")" log -1 --format=%ct 2>/dev/null || date +%s)
tar -C "$work" --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$time" -cf - "$name" | gzip -9n >"$out/$name.tar.gz"
rm -f "$log"
printf 'make_archive: %s/%s.tar.gz: %s MB, unpacked %s MB, %s libraries\n' "$out" "$name" \
  "$(du -m "$out/$name.tar.gz" | cut -f1)" "$(du -sm "$stage" | cut -f1)" "$(wc -l <"$work/needs")"
