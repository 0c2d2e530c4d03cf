"""A step of many samples at once: `offpiste_real` as a GNU vector, as exports for CPUs may use it."""

import ctypes

import numpy as np
import torch

from dynamics.kernels.test_rollout import CHANNELS, example, windows
from host_kernels import compiled, needs_gcc
from offpiste.core.state import RecordedTerrain
from offpiste.dynamics import Hybrid, rollout
from offpiste.dynamics.header.networks import packed_parameters
from offpiste.dynamics.header.step_text import step_text
from offpiste.dynamics.kernels.model_state import to_kernel_state

LANES = 16
TOP = """
#include <math.h>
typedef float offpiste_real __attribute__((vector_size(4 * 16), aligned(4)));
#define OFFPISTE_REAL
static inline offpiste_real offpiste_floor(offpiste_real x) {
    for (int i = 0; i < 16; i++) x[i] = floorf(x[i]);
    return x;
}
static inline offpiste_real offpiste_maximum(offpiste_real a, offpiste_real b) { return a > b ? a : b; }
static inline offpiste_real offpiste_maximum(offpiste_real a, float b) { return a > b ? a : b; }
"""
FOLLOW = """
extern "C" void follow(const offpiste_params* params, const offpiste_given* given, offpiste_real* state, int steps) {
    for (int t = 0; t < steps; t++) offpiste_step(params, given + t, state);
}
"""


@needs_gcc
def test_a_vector_of_samples_steps_as_each_alone():
    model = example(*CHANNELS["no throttle"], codes=2, kind=Hybrid).float().requires_grad_(False)
    model_state, controls, terrain = windows(model, LANES, 6)
    wanted = rollout(model, model_state, controls, RecordedTerrain(terrain))
    library = compiled(TOP + step_text(model) + FOLLOW, "-Wno-psabi", "-Wno-ignored-attributes")
    unknown = (~terrain.known).float().mean(dim=-1, keepdim=True)
    given = torch.cat((controls, terrain.normal.mean(dim=-2), unknown, terrain.latent.flatten(-2)), dim=-1)
    rows = given.permute(1, 2, 0).contiguous().numpy()
    state = to_kernel_state(model_state).t().contiguous().numpy()
    params = packed_parameters(model).numpy()
    library.follow(*(ctypes.c_void_p(array.ctypes.data) for array in (params, rows, state)), ctypes.c_int(6))
    np.testing.assert_allclose(state[:6].T, wanted.state[:, -1].numpy(), atol=2e-4, rtol=1e-4)
