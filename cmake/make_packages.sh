#!/usr/bin/env bash
# Makes .debs and the archive of a finished build: what `./run package` calls.
set -euo pipefail

if (($# != 2)); then
  printf 'Usage: cmake/make_packages.sh BUILD_DIR OUT_DIR\n' >&2
  exit 2
fi
build=$(cd "$1" && pwd)
mkdir -p "$2"
out=$(cd "$2" && pwd)
version=$(sed -n 's/^CMAKE_PROJECT_VERSION:STATIC=//p' "$build/CMakeCache.txt")
rm -f "$out"/*.deb "$out"/*.tar.gz
(umask 022 && cd "$build" && cpack -G DEB -B "$out" >"$out/cpack.log") || {
  tail -20 "$out/cpack.log" >&2
  exit 1
}
rm -rf "$out/_CPack_Packages" "$out/cpack.log"
"$(dirname "$0")/make_archive.sh" "$build" "robostress-$version-linux-$(uname -m)" "$out"
ls -l "$out"
