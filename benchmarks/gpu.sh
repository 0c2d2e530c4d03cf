#!/usr/bin/env bash
# Everything that needs an NVIDIA GPU, in one call of under 10 minutes and without network: parity, memory checks, times.
#
#     bash benchmarks/gpu.sh [FOLDER] [--dataset DATASET]
#
# Needs a Python (`python`, or else `python3`) with a torch built for CUDA and offpiste's extra `cuda`. Where nothing can
# be installed from a network, WHEELS names a folder of wheels that benchmarks/gpu_wheels.sh made elsewhere; they are
# used by this run alone. Stages that lack a tool (nvcc, compute-sanitizer, pytorch_mppi, pytest, MPPI-Generic) are
# skipped with a line that says so. Writes gpu.md, gpu.json and a log for each stage into the folder; the exit code is 1
# where a stage failed (gpu_stages.py).
here=$(cd "$(dirname "$0")" && pwd)
python=$(command -v python || command -v python3) || { echo "no python is there" >&2; exit 1; }
export PYTHONPATH="$here/../src:$here:${PYTHONPATH:-}"
if [[ -n "${WHEELS:-}" ]]; then
  site=$(mktemp -d)
  trap 'rm -rf "$site"' EXIT
  "$python" -m pip install --quiet --no-index --no-deps --no-compile --target "$site" "$WHEELS"/*.whl || exit 1
  export PYTHONPATH="$PYTHONPATH:$site"
fi
"$python" "$here/gpu_stages.py" "$@"
