#!/usr/bin/env bash
# Everything that needs an NVIDIA GPU, in one call of under 10 minutes and without network: parity, memory checks, times.
#
#     bash benchmarks/gpu.sh [FOLDER]
#
# Needs a checkout with its extra `cuda` installed (pip install -e '.[cuda]') and a torch built for CUDA. With nvcc it
# also runs the exported CUDA example; with compute-sanitizer it checks every access of a small run. Writes gpu.json and
# gpu.md into the folder.
set -euo pipefail
out=${1:-gpu-results}
mkdir -p "$out"
here=$(dirname "$0")
export PYTHONPATH="$here/../src:$here:$here/../tests:${PYTHONPATH:-}"
{
    python "$here/gpu.py" --out "$out/gpu.json"
    echo
    if command -v compute-sanitizer >/dev/null; then
        compute-sanitizer --tool memcheck --error-exitcode 1 python "$here/gpu.py" --small --out "$out/small.json" 2>&1 | tail -n 1
    else
        echo "compute-sanitizer is not there: memory accesses were not checked"
    fi
    if command -v nvcc >/dev/null; then
        rm -rf "$out/export"
        python -m offpiste export pretrained:proving-ground/dc --to "$out/export" --format cuda >/dev/null
        (cd "$out/export" && nvcc -std=c++17 -O3 -arch=native example.cu -o example && ./example parity.bin | tail -n 1)
    else
        echo "nvcc is not there: the exported example was not run"
    fi
} | tee "$out/gpu.md"
