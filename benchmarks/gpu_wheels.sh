#!/usr/bin/env bash
# Wheels for benchmarks/gpu.sh on a computer without network that has torch for CUDA and the other packages of `there`.
#
#     bash benchmarks/gpu_wheels.sh WHEELS [3.12]
#
# Downloads what such an image lacks for its version of Python, and makes a wheel of this checkout.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
folder=${1:?usage: bash benchmarks/gpu_wheels.sh WHEELS [PYTHON VERSION]}
platforms=(manylinux_2_28_x86_64 manylinux_2_24_x86_64 manylinux_2_17_x86_64 manylinux2014_x86_64)
there=(cuda-core jaxtyping msgpack opencv-python-headless pillow pytest pyyaml rich safetensors scipy torch tqdm)
packages=(apsw backports.zstd beartype docstring-parser donfig google-crc32c hypothesis lz4 mcap
  msgspec numcodecs rosbags ruamel.yaml tomlkit typeguard tyro zarr==3.1.6 zstandard)
echo "${folder}: for a computer that has ${there[*]}"
mkdir -p "$folder"
python3 -m pip download --quiet --no-deps --only-binary=:all: --python-version "${2:-3.12}" --implementation cp \
  "${platforms[@]/#/--platform=}" --dest "$folder" "${packages[@]}"
python3 -m pip wheel --quiet --no-deps --wheel-dir "$folder" "$here/.."
