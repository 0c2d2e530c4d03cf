#!/usr/bin/env bash
# Everything that needs an NVIDIA GPU, in one call of under 10 minutes and without network: parity, memory checks, times.
#
#     bash benchmarks/gpu.sh [FOLDER]
#
# Needs a checkout with its extra `cuda` installed (pip install -e '.[cuda]') and a torch built for CUDA. Stages that
# lack a tool (nvcc, compute-sanitizer, pytorch_mppi, pytest, MPPI-Generic) are skipped with a line that says so. Writes
# gpu.md, gpu.json and a log for each stage into the folder; the exit code is 1 where a stage failed (gpu_stages.py).
here=$(cd "$(dirname "$0")" && pwd)
export PYTHONPATH="$here/../src:$here:$here/../tests:${PYTHONPATH:-}"
exec python "$here/gpu_stages.py" "$@"
