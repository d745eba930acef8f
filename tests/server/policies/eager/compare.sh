#!/bin/bash
# compare.sh [--policy nano|pi0|pi05] [--rounds N] [--threads N] [options of policy_benchmark]
# Ours beside PyTorch's eager mode (python3-torch) and beside the matrix products alone. PROGRAM: policy_benchmark.
set -eu
here=$(dirname "$(readlink -f "$0")")
program=${PROGRAM:-$here/../../../build/release/bin/policy_benchmark}
threads=1
previous=
for argument in "$@"; do
  if [ "$previous" = --threads ]; then threads=$argument; fi
  previous=$argument
done
export OMP_NUM_THREADS=$threads OPENBLAS_NUM_THREADS=$threads
exec "${PYTHON:-/usr/bin/python3}" "$here/compare.py" --program "$program" "$@"
