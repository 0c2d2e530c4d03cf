#!/usr/bin/env bash
# Run all checks that need an NVIDIA GPU, each with a time limit: parity, memory checks, times. Needs no network.
#
#     bash benchmarks/gpu.sh [FOLDER] [STAGE ...]
#
# Needs a Python (`python`, or else `python3`) with torch for CUDA and the extra `cuda` of offpiste. Without network,
# set WHEELS to a folder of wheels made by benchmarks/gpu_wheels.sh; this run alone uses them. Set DATASET to a dataset
# with features to compare trainings as well. Writes FOLDER/STAGE.log, FOLDER/STAGE.json and FOLDER/gpu.md. A stage
# without its tool is skipped; the exit code is 1 if a stage failed.
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd)
python=$(command -v python || command -v python3) || { echo "python is missing" >&2; exit 1; }
export PYTHONPATH="$here/../src:$here:${PYTHONPATH:-}"
if [[ -n "${WHEELS:-}" ]]; then
  site=$(mktemp -d)
  trap 'rm -rf "$site"' EXIT
  "$python" -m pip install --quiet --no-index --no-deps --no-compile --target "$site" "$WHEELS"/*.whl || exit 1
  export PYTHONPATH="$PYTHONPATH:$site"
fi
folder=${1:-gpu-results}
stages=("${@:2}")
[[ ${#stages[@]} -gt 0 ]] || stages=(plans spread images training train example memcheck pytest)
mkdir -p "$folder" && folder=$(cd "$folder" && pwd) || exit 1

failed=0
report() { echo "| $1 | $2 |" | tee -a "$folder/gpu.md"; }

# Usage: stage NAME SECONDS TOOL COMMAND ...
stage() {
  [[ " ${stages[*]} " == *" $1 "* ]] || return 0
  if [[ -n "$3" ]] && ! command -v "$3" >/dev/null; then report "$1" "skipped: $3 is missing"; return 0; fi
  if timeout --kill-after=5 "$2" "${@:4}" >"$folder/$1.log" 2>&1; then
    report "$1" "done: $(tail -n 1 "$folder/$1.log")"
  else
    report "$1" "failed with exit code $? (124: longer than $2 s): $(tail -n 1 "$folder/$1.log")"
    failed=1
  fi
}

device=$("$python" "$here/gpu.py" 2>&1) || { echo "no stage was run: $(tail -n 1 <<<"$device")" >&2; exit 1; }
printf '%s\n\n| stage | result |\n|---|---|\n' "$device" | tee "$folder/gpu.md"
for name in plans spread images training; do
  stage $name 150 "" "$python" "$here/gpu.py" $name --out "$folder/$name.json"
done
[[ -z "${DATASET:-}" ]] || stage train 150 "" "$python" "$here/gpu.py" train --dataset "$DATASET" --out "$folder/train.json"
stage example 90 nvcc bash -euc "rm -rf '$folder/cuda'
  '$python' -m offpiste export pretrained:proving-ground/dc --to '$folder/cuda' --format cuda
  cd '$folder/cuda'; nvcc -std=c++17 -O3 -arch=native example.cu -o example; ./example parity.bin"
# Every array is its own allocation, so that memcheck sees its end. cuda-core probes functions of later drivers.
stage memcheck 200 compute-sanitizer env PYTORCH_NO_CUDA_MEMORY_CACHING=1 compute-sanitizer --tool memcheck \
  --report-api-errors no --error-exitcode 1 "$python" "$here/gpu.py" plans spread training --small --out "$folder/memcheck.json"
cd "$here/.." || exit 1
stage pytest 150 "" "$python" -m pytest -q -rs -k "nvrtc or a_gpu or cuda_gives or test_cuda_kernels" \
  tests/dynamics tests/native tests/perception/backbones tests/planning
exit $failed
