"""Exports as C and CUDA, compiled and run without Python."""

import json
import shutil
import subprocess
from dataclasses import replace
from importlib.resources import files

import pytest
import torch

from cli.command import run as offpiste
from dynamics.kernels.test_rollout import CHANNELS, example
from factories import VEHICLE, unsettled
from host_kernels import needs_gcc, needs_nvcc
from offpiste.core import channels
from offpiste.core.errors import OffpisteError, RunError
from offpiste.core.registry import Registry
from offpiste.dynamics import ConstantMotion, Hybrid
from offpiste.dynamics.feature_encoder import Compressor, FeatureEncoder, Identity
from offpiste.exports.c_files import model_header
from offpiste.exports.formats import ImageOptions, export, refuse_without_kernels
from offpiste.exports.parity import parity_bytes, parity_case
from offpiste.training.run import load_run

SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
"""A leak, and an access out of bounds, end the program with an error."""


def compiled_and_run(folder, *compiler):
    compiler = compiler or ("gcc", "-std=c99", "-O1", *SANITIZED, "-Wall", "-Wextra", "-Werror", "example.c")
    made = subprocess.run([*compiler, "-o", "example", "-lm"], cwd=folder, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr[:3000]
    return subprocess.run(["./example", "parity.bin"], cwd=folder, capture_output=True, text=True)


@needs_gcc
@pytest.mark.parametrize(("name", "option"), [("dc", "--to"), ("parametric", "--out")])
def test_a_c_program_drives_5_s_and_agrees_with_predictions(name, option, tmp_path):
    assert offpiste("export", f"pretrained:proving-ground/{name}", option, tmp_path / "out") == 0
    ran = compiled_and_run(tmp_path / "out")
    assert ran.returncode == 0, ran.stdout
    assert float(ran.stdout.split("at most ")[1].split()[0]) < 2e-4
    about = json.loads((tmp_path / "out" / "model.json").read_text())
    assert about["weights_sha256"] in (tmp_path / "out" / "offpiste.h").read_text()
    assert about["weights_sha256"] in (tmp_path / "out" / "README.md").read_text()


def made_up(kind):
    """Models unlike the shipped ones: absent channels, a gear, uncompressed features."""
    vehicle = replace(VEHICLE, wheelbase=2.2)
    torch.manual_seed(0)
    model = {
        "no actuators": lambda: example(*CHANNELS["no actuators"], codes=0, kind=Hybrid),
        "gear without throttle": lambda: example(*CHANNELS["gear without throttle"], codes=0, kind=Hybrid),
        "features as they are": lambda: Hybrid(vehicle, encoder=Identity(2)),
        "features": lambda: Hybrid(vehicle, encoder=Compressor(2)),
    }[kind]()
    if isinstance(model, Hybrid):
        torch.nn.init.normal_(model.compensator.output[-1].weight, std=0.1)
    return unsettled(model.float(), scale=0.05).requires_grad_(False)


def write_example(kind, folder, names=("example.c", "parity.h"), **options):
    """Write the parts of an export that its example needs; returns the parity case."""
    dynamics = made_up(kind)
    (folder / "offpiste.h").write_text(model_header(dynamics, "Made up."))
    case = parity_case(dynamics, **options)
    (folder / "parity.bin").write_bytes(parity_bytes(case))
    for name in names:
        shutil.copy(str(files("offpiste.exports") / "files" / name), folder)
    return case


@needs_gcc
@pytest.mark.parametrize("kind", ["no actuators", "gear without throttle", "features as they are"])
def test_every_kind_of_model_agrees(kind, tmp_path):
    write_example(kind, tmp_path, steps=100)
    header = (tmp_path / "offpiste.h").read_text()
    assert ("gear, which is -1 (reverse), 0 (neutral) or 1 (forward)" in header) == ("gear" in kind)
    ran = compiled_and_run(tmp_path)
    assert ran.returncode == 0, ran.stdout


@needs_gcc
def test_the_example_fails_for_wrong_numbers_and_for_damaged_or_foreign_files(tmp_path):
    case = write_example("features", tmp_path, steps=100)
    assert compiled_and_run(tmp_path).returncode == 0

    def fails(content):
        (tmp_path / "parity.bin").write_bytes(content)
        ran = subprocess.run(["./example"], cwd=tmp_path, capture_output=True, text=True)
        assert ran.returncode == 1
        return ran.stderr

    for column, value in ((0, torch.nan), (2, 9.0), (4, 0.01)):
        expected = case.expected.clone()
        expected[0, :, column] += value
        fails(parity_bytes(replace(case, expected=expected)))
    whole = parity_bytes(case)
    assert fails(whole[:-4]) == "parity.bin: is damaged or cut short; export it again\n"
    for at in (5, 30, 40, 60, len(whole) // 2, len(whole) - 10):
        flipped = bytearray(whole)
        flipped[at] ^= 1
        fails(flipped)
    other = parity_case(unsettled(made_up("features"), scale=0.01), steps=100)
    assert fails(parity_bytes(other)) == "parity.bin: belongs to another model than offpiste.h\n"


@needs_nvcc
def test_the_cuda_example_compiles_without_spills(tmp_path):
    export("pretrained:proving-ground/dc", tmp_path / "out", "cuda")
    command = ["nvcc", "-std=c++17", "-arch=sm_90", "-Xptxas", "-v", "example.cu", "-o", "example"]
    made = subprocess.run(command, cwd=tmp_path / "out", capture_output=True, text=True)
    assert made.returncode == 0, made.stderr[:2000]
    assert "0 bytes spill stores, 0 bytes spill loads" in made.stderr


def test_what_cannot_be_exported_is_refused(tmp_path, monkeypatch):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OffpisteError, match="is not empty"):
        export("pretrained:proving-ground/dc", tmp_path, "c")
    with pytest.raises(OffpisteError, match="no export format 'cuba'; did you mean 'cuda'"):
        export("pretrained:proving-ground/dc", tmp_path / "new", "cuba")
    for images, option in ((ImageOptions(tmp_path), "--images"), (ImageOptions(size=(640, 360)), "--size")):
        with pytest.raises(OffpisteError, match=f"{option} is for --format onnx"):
            export("pretrained:proving-ground/dc", tmp_path / "new", "c", images)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.txt"]
    run = load_run("pretrained:proving-ground/b")
    run.dynamics.requires_grad_(True)
    refuse_without_kernels(run)  # a model that still learns its actuators is accepted
    with pytest.raises(RunError, match="'ctrv' has no kernels"):
        refuse_without_kernels(replace(run, dynamics=ConstantMotion(VEHICLE), model="ctrv"))
    monkeypatch.setattr(channels, "MORE_CONTROLS", Registry("control"))
    channels.register_control(channels.Control("diff_lock", low=0.0, high=1.0))
    locked = Hybrid(replace(VEHICLE, control=(*VEHICLE.control, "diff_lock")))
    with pytest.raises(RunError, match="'b' has no kernels: they do not know diff_lock; export"):
        refuse_without_kernels(replace(run, dynamics=locked))


class Scaled(FeatureEncoder):
    """An encoder of an extension."""

    def __init__(self, features):
        super().__init__()
        self.size = features
        self.register_buffer("mean", torch.zeros(features))

    def forward(self, features, valid):
        """Codes."""
        return torch.tanh(3 * features)


def test_an_encoder_without_c_code_is_refused():
    dynamics = Hybrid(replace(VEHICLE, features=3), encoder=Scaled(3))
    run = replace(load_run("pretrained:proving-ground/b"), dynamics=dynamics)
    with pytest.raises(RunError, match="'b' has no kernels: its encoder is a Scaled"):
        refuse_without_kernels(run)
    with pytest.raises(ValueError, match="no C code of this encoder: its encoder is a Scaled"):
        model_header(dynamics, "Made up.")
