"""Export of models as C and CUDA source, and as dynamics for MPPI-Generic."""

import shutil
import textwrap
from importlib.resources import as_file, files
from pathlib import Path
from string import Template
from typing import Any, Final

import numpy as np
from torch import Tensor

from offpiste.core.conventions import HISTORY_STEPS
from offpiste.core.files import write_bytes, write_text
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.networks import network_members, parameter_constants
from offpiste.dynamics.header.start_text import encoder_members, encoder_text, start_members, start_text
from offpiste.dynamics.header.step_text import shipped_text, step_text
from offpiste.dynamics.kernels.networks import model_networks
from offpiste.exports.formats import FORMATS, ImageOptions, refuse_images, refuse_without_kernels, write_about
from offpiste.exports.parity import digest_of, features_of, parity_bytes, parity_case
from offpiste.training.run import Run

HEADER: Final = "offpiste.h"

WIDTH: Final = 118
"""Maximum length of lines of numbers."""


def model_header(dynamics: Dynamics, about: str) -> str:
    """Return the C header of a model: code of step, ground, start and encoder, if any, and the weights.

    Args:
        about: text of the comment at the top.
    """
    parts = [step_text(dynamics), shipped_text("terrain.h"), shipped_text("ground.h"), start_text(dynamics)]
    if dynamics.encoder is not None:
        parts.append(encoder_text(dynamics.encoder))
    parts.append(_weights_text(dynamics))
    sizes = {"DIGEST": f'"{digest_of(dynamics)}"', "FEATURES": features_of(dynamics), "PAST": HISTORY_STEPS}
    own = (f"#define OFFPISTE_{name} {value}" for name, value in sizes.items())
    top = (f"/* {about} */", "#ifndef OFFPISTE_H", "#define OFFPISTE_H", "", *own, "")
    return "\n".join((*top, *parts, "#endif /* OFFPISTE_H */", ""))


def _weights_text(dynamics: Dynamics) -> str:
    """Return the C definitions of `offpiste_model`, `offpiste_starts` and, with an encoder, `offpiste_features`."""
    networks = {of.name: network_members(of) for of in model_networks(dynamics)}
    starts = start_members(dynamics)
    parts = [
        _struct("offpiste_params", "offpiste_model", {"constants": parameter_constants(dynamics), **networks}),
        _struct("offpiste_start_params", "offpiste_starts", starts),
    ]
    if dynamics.encoder is not None:
        parts.append(_struct("offpiste_encoder", "offpiste_features", encoder_members(dynamics.encoder)))
    return "\n".join(parts)


def _struct(kind: str, name: str, members: object) -> str:
    # OFFPISTE_CONSTANT suppresses warnings about constants that a program does not use.
    return f"OFFPISTE_CONSTANT {kind} {name} = {_initialiser(members) if members else '{0.0f}'};\n"


def _initialiser(value: object) -> str:
    if isinstance(value, dict):
        parts = [f"/* {name} */\n{_initialiser(inner)}" for name, inner in value.items()]
        return "{\n" + ",\n".join(parts) + "\n}"
    assert isinstance(value, Tensor)
    numbers = value.detach().float().cpu().numpy()
    if numbers.ndim == 1:
        return _wrapped([_number(number) for number in numbers])
    return "{\n" + ",\n".join(_wrapped([_number(number) for number in row]) for row in numbers) + "\n}"


def _number(value: np.float32) -> str:
    text = f"{value:.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


def _wrapped(numbers: list[str]) -> str:
    return textwrap.fill("{" + ", ".join(numbers) + "}", WIDTH, break_on_hyphens=False)


@FORMATS.register("c")
def write_c(run: Run, folder: Path, images: ImageOptions) -> None:
    """Write C99: `offpiste.h` and `example.c`, which checks it on the parity file."""
    refuse_images(images)
    _write(run, folder, ("example.c",), command="cc -std=c99 -O2 example.c -o example -lm", language="C99 and C++")


@FORMATS.register("cuda")
def write_cuda(run: Run, folder: Path, images: ImageOptions) -> None:
    """Write CUDA: the same header, and `example.cu` with one drive per thread."""
    refuse_images(images)
    write_text(folder / "kernels.h", shipped_text("kernels.h"))
    command = "nvcc -std=c++17 -O3 -arch=native example.cu -o example"
    _write(run, folder, ("example.cu",), command=command, language="CUDA (nvcc, NVRTC), C99 and C++")


@FORMATS.register("mppi-generic")
def write_mppi_generic(run: Run, folder: Path, images: ImageOptions) -> None:
    """Write C++ for ACDSLab's MPPI-Generic: `OffpisteDynamics`, an example cost and a planner."""
    refuse_images(images)
    names = ("offpiste_dynamics.cuh", "offpiste_cost.cuh", "drive.cu", "planner.cu")
    _write(run, folder, names, readme="README-mppi-generic.md")


def _write(run: Run, folder: Path, names: tuple[str, ...], *, readme: str = "README-c.md", **text: str) -> None:
    refuse_without_kernels(run)
    about = write_about(run, folder)
    first = f"Vehicle model {run.model} of offpiste {about['offpiste']}, weights {about['weights_sha256']}."
    write_text(folder / HEADER, model_header(run.dynamics, first))
    write_bytes(folder / "parity.bin", parity_bytes(parity_case(run.dynamics)))
    for name in (*names, "parity.h"):
        with as_file(files(__package__) / "files" / name) as source:
            shutil.copyfile(source, folder / name)
    write_readme(folder, readme, about, **text)


def write_readme(folder: Path, template: str, about: dict[str, Any], **text: str) -> None:
    """Write README.md from a template, the contents of model.json (`about`) and other texts."""
    shown = {name: ", ".join(map(str, value)) if isinstance(value, list) else value for name, value in about.items()}
    absent = shown["absent_actuators"] or "none"
    template = (files(__package__) / "files" / template).read_text("utf-8")
    write_text(folder / "README.md", Template(template).substitute(shown, absent=absent, **text))
