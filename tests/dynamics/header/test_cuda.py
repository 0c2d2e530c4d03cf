"""The printed kernels compiled for GPUs, where there is nvcc: their registers and spills."""

import re
import subprocess

import pytest

from host_kernels import needs_nvcc
from offpiste.dynamics.header.recorded import recorded_text
from offpiste.native.cuda_kernels import machine_code
from offpiste.planning.caution import Caution
from offpiste.planning.header.cost_text import plan_text
from offpiste.training.run import load_run
from offpiste.uncertainty.fit import load_spread
from planning_maps import situation

pytestmark = needs_nvcc


def used(text, architecture, folder, *flags):
    """Registers, and bytes spilled, of each kernel of a text."""
    source = folder / "kernels.cu"
    source.write_text(text)
    command = ["nvcc", "-std=c++17", f"-arch={architecture}", *flags, "-Xptxas", "-v", "-cubin"]
    command += [source, "-o", folder / "cubin"]
    found = subprocess.run(command, text=True, capture_output=True)
    assert found.returncode == 0, found.stderr[:3000]
    numbers = re.findall(
        r"entry function '(\w+)'.*?(\d+) bytes spill stores.*?Used (\d+) registers", found.stderr, re.S
    )
    return {name: (int(registers), int(spilled)) for name, spilled, registers in numbers}


@pytest.mark.parametrize("architecture", ["sm_80", "sm_87", "sm_90"])
def test_kernels_keep_a_step_in_registers(architecture, tmp_path):
    run = load_run("pretrained:proving-ground/dc")
    dynamics = run.dynamics.requires_grad_(False)
    kernels = used(recorded_text(dynamics), architecture, tmp_path)
    for name, caution in (("", None), (" with a spread", Caution(load_spread(run), 1.0))):
        plan = plan_text(dynamics, situation().costs.table, caution, lanes=True)
        found = used(plan, architecture, tmp_path, "-prec-div=false", "-prec-sqrt=false")
        assert found.keys() == {"offpiste_roll_out", "offpiste_keep_within"}
        kernels |= {kernel + name: numbers for kernel, numbers in found.items()}
    print(architecture, kernels)
    assert kernels.keys() > {"offpiste_forward", "offpiste_backward"}
    for name, (registers, spilled) in kernels.items():
        # Backwards a thread holds adjoints of state and constants, and what the step computed: more than there are.
        assert spilled <= (1024 if name == "offpiste_backward" else 64), name
        assert registers <= 255, name


def test_nvrtc_compiles_them_too():
    pytest.importorskip("cuda.core", reason="the extra cuda is not installed")
    pytest.importorskip("cuda.bindings.nvrtc", reason="no NVRTC here")
    dynamics = load_run("pretrained:proving-ground/dc").dynamics.requires_grad_(False)
    for text in (recorded_text(dynamics), plan_text(dynamics, situation().costs.table, lanes=True)):
        assert len(machine_code(text, "sm_90").code) > 30_000
