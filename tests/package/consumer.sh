#!/usr/bin/env bash
# consumer.sh BUILD SCRATCH COMPILER: builds a project of somebody else against the installed CMake package and runs it.
set -euo pipefail
build=$1 scratch=$2 compiler=$3
rm -rf "$scratch"
run() {
  "$@" >"$scratch.log" 2>&1 || {
    echo "FAILED: $*"
    tail -30 "$scratch.log"
    exit 1
  }
}
run cmake --install "$build" --prefix "$scratch/first" --component dev
mv "$scratch/first" "$scratch/prefix" # the package names no place
run cmake -S "$(dirname "$0")/consumer" -B "$scratch/build" -DCMAKE_PREFIX_PATH="$scratch/prefix" \
  -DCMAKE_CXX_COMPILER="$compiler" -DCMAKE_BUILD_TYPE=Release
run cmake --build "$scratch/build"
if [[ -e $build/lib/librobostress.so.1 ]]; then
  run cmake --install "$build" --prefix "$scratch/prefix" --component library
  library=$(dirname "$(find "$scratch/prefix" -name librobostress.so.1)")
  read -ra flags < <(PKG_CONFIG_PATH=$library/pkgconfig pkg-config --cflags --libs robostress)
  run cc "$(dirname "$0")/../python/library/pendulum.c" -o "$scratch/build/pendulum" "${flags[@]}" -lm
  LD_LIBRARY_PATH=$library "$scratch/build/pendulum"
fi
"$scratch/build/core"
"$scratch/build/caller"
