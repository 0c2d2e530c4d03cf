"""New checksums after a mutation."""

import contextlib
import json
from pathlib import Path

import google_crc32c
from safetensors import safe_open
from safetensors.numpy import save_file

from offpiste.core.checksums import sha256_of, sha256_of_arrays, sha256_of_json, write_checksums


def seal_dataset(folder: Path) -> None:
    for file in sorted(folder.rglob("*")):
        if file.is_file() and "c" in file.parts and file.suffix == "":
            content = file.read_bytes()[:-4]
            file.write_bytes(content + google_crc32c.value(content).to_bytes(4, "little"))
    for place in (folder, *(entry for entry in sorted(folder.iterdir()) if entry.is_dir())):
        files = [place / "zarr.json"] if place == folder else sorted(place.rglob("zarr.json"))
        write_checksums(place, [file for file in files if file.is_file()])


def seal_run(folder: Path) -> None:
    for file in folder.glob("*.safetensors"):
        seal_tensors(file)
    about_file = folder / "model.json"
    with contextlib.suppress(OSError, ValueError, RecursionError, TypeError):
        about = json.loads(about_file.read_text("utf-8"))
        about["weights_sha256"] = sha256_of(folder / "model.safetensors")
        about.pop("sha256", None)
        about["sha256"] = sha256_of_json(about)
        about_file.write_text(json.dumps(about))


def seal_tensors(file: Path) -> None:
    with contextlib.suppress(Exception):
        with safe_open(file, framework="numpy") as opened:
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
            header = dict(opened.metadata() or {})
        key = "offpiste_pca" if "offpiste_pca" in header else "about"
        about = {name: value for name, value in json.loads(header[key]).items() if name != "sha256"}
        header[key] = json.dumps({**about, "sha256": sha256_of_arrays(tensors, about)})
        save_file(tensors, file, metadata=header)
