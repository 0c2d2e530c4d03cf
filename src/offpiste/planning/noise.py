"""Low-frequency noise of unit variance for sampled control sequences."""

from collections.abc import Callable, Sequence
from ctypes import Structure, c_int, c_uint64, c_void_p
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt32
from torch import Generator, Tensor

from offpiste.native.library import library
from offpiste.native.tensors import CHUNK, Arrays, call

Shape = tuple[int, int, int]
"""Samples K, steps T, controls U."""

Noise = Callable[[Shape, Generator, torch.dtype], Tensor]
"""Function that draws unit noise [K, T, U] on the generator's device; samples and controls are independent."""


def coloured(
    shape: Shape,
    generator: Generator,
    dtype: torch.dtype = torch.float32,
    *,
    exponent: float = 2.0,
    period: int | None = None,
    highest: int | None = None,
) -> Float[Tensor, "K T U"]:
    """Draw noise of power 1 / f^exponent and variance 1 at every step (Vlahov et al., RA-L 2024).

    Drawn in the frequency domain (Timmer & Koenig, 1995), so the spectrum over the period is exact; the mean, f = 0,
    has the power of the lowest frequency.

    On the CPU the generator gives only a seed: numbers come from a generator without state (`threefry`), and are the
    same on any number of threads.

    Args:
        exponent: 0 white, 1 pink, 2 like a random walk.
        period: period of the noise [steps]; 2 T by default, so that its end does not depend on its start.
        highest: highest frequency drawn [1 / period]; None for all.

    Raises:
        ValueError: the period is shorter than the steps, or zero.
    """
    samples, steps, controls = shape
    if generator.device.type != "cpu":
        size = coefficient_sizes(steps, exponent=exponent, period=period, highest=highest)
        return from_coefficients(shape, generator, size.to(generator.device, dtype), period or 2 * steps)
    period = _checked(period, steps)
    deviation = spectrum(period, exponent, highest).sqrt().div(period).float()
    seed = int(torch.randint(2**62, (), generator=generator))
    if library() is None:
        return torch.from_numpy(draw_plainly(seed, deviation.numpy(), period, shape)).to(dtype)
    noise, arrays = torch.empty(samples, steps, controls, dtype=torch.float32), Arrays()
    pointers = arrays.floats(deviation), arrays.floats(torch.from_numpy(_roots(period)))
    colour = _Colour(*pointers, len(deviation), period, samples, steps, controls, seed)
    call("draw_noise", -(-samples // CHUNK), colour, noise)
    return noise.to(dtype)


class _Colour(Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("deviation", "roots")),
        *((name, c_int) for name in ("frequencies", "period", "samples", "steps", "controls")),
        ("seed", c_uint64),
    )


@cache
def _roots(period: int) -> Float[np.ndarray, "period 2"]:
    angle = 2 * np.pi * np.arange(period) / period
    return np.stack((np.cos(angle), np.sin(angle)), axis=-1).astype(np.float32)


def draw_plainly(
    seed: int, deviation: Float[np.ndarray, " frequencies"], period: int, shape: Shape
) -> Float[np.ndarray, "K T U"]:
    """Draw noise as `native/cpp/noise.h` does.

    Args:
        deviation: standard deviation of real and imaginary part of each coefficient.
    """
    samples, steps, controls = shape
    pairs, count = -(-samples // CHUNK) * (CHUNK // 2), len(deviation)
    series = np.arange(pairs * controls, dtype=np.uint32)[:, None]
    drawn = threefry((seed % 2**32, seed >> 32, 0, 0), (np.arange(count, dtype=np.uint32), series, 0, 0))
    uniform = (drawn >> 8).astype(np.float32) * np.float32(2**-24)
    up, down = np.sqrt(-2 * np.log(1 - uniform[::2])) * np.exp(2j * np.pi * (uniform[1::2] - 0.5))
    coefficients = np.zeros((len(series), period), np.complex64)
    coefficients[:, :count] = deviation * up
    negative = np.arange(1, min(count, (period + 1) // 2))
    coefficients[:, -negative] = (deviation * down)[:, negative]
    pairs_of_series = (period * np.fft.ifft(coefficients)[:, :steps]).reshape(-1, CHUNK // 2, controls, steps)
    both = np.stack((pairs_of_series.real, pairs_of_series.imag), axis=1)
    return np.ascontiguousarray(both.reshape(-1, controls, steps)[:samples].swapaxes(1, 2), np.float32)


def threefry(key: Sequence[int], counter: Sequence[np.ndarray | int]) -> UInt32[np.ndarray, "4 ..."]:
    """Return four random numbers for each counter: Threefry-4x32-20 (Salmon et al., SC 2011).

    Args:
        key: four numbers below 2^32.
        counter: four numbers, or arrays (uint32) that are broadcast.
    """
    turns = ((10, 26), (11, 21), (13, 27), (23, 5), (6, 20), (17, 11), (25, 10), (18, 20))
    keys = [np.uint32(part) for part in (*key, 0x1BD11BDA ^ key[0] ^ key[1] ^ key[2] ^ key[3])]
    with np.errstate(over="ignore"):
        started = (np.uint32(part) + first for part, first in zip(counter, keys[:4], strict=True))
        x = np.array(np.broadcast_arrays(*started))
        for turn in range(20):
            for first, second, angle in zip((0, 2), (3, 1) if turn % 2 else (1, 3), turns[turn % 8], strict=True):
                x[first] += x[second]
                x[second] = (x[second] << angle | x[second] >> (32 - angle)) ^ x[first]
            if turn % 4 == 3:
                past = turn // 4 + 1
                for i in range(4):
                    x[i] += keys[(past + i) % 5] + np.uint32(past if i == 3 else 0)
    return x


def coefficient_sizes(
    steps: int, *, exponent: float = 2.0, period: int | None = None, highest: int | None = None
) -> Float[Tensor, " frequencies"]:
    """Return the root mean square of each coefficient that `from_coefficients` draws (float64).

    Raises:
        ValueError: the period is shorter than the steps, or zero.
    """
    period = _checked(period, steps)
    power = spectrum(period, exponent, highest)
    # `irfft` reads only the real part of the first and the last coefficient, which must have all of the power.
    power[0] *= 2
    if period % 2 == 0 and len(power) > period // 2:
        power[-1] *= 2
    return torch.sqrt(power)


def _checked(period: int | None, steps: int) -> int:
    period = 2 * steps if period is None else period
    if period < max(steps, 1):
        raise ValueError(f"the period of noise ({period}) must be positive, and at least the number of steps ({steps})")
    return period


def from_coefficients(
    shape: Shape, generator: Generator, size: Float[Tensor, " frequencies"], period: int
) -> Float[Tensor, "K T U"]:
    """Draw noise on a GPU, with coefficients of these root mean squares."""
    samples, steps, controls = shape
    drawn = (samples, controls, len(size))
    parts = torch.randn(drawn, generator=generator, dtype=size.dtype.to_complex(), device=generator.device)
    return torch.fft.irfft(parts.mul_(size), n=period)[..., :steps].transpose(1, 2)


def spectrum(period: int, exponent: float, highest: int | None = None) -> Float[Tensor, " frequencies"]:
    """Return the mean square of each coefficient of `torch.fft.rfft` of one period of `coloured` (float64)."""
    step = torch.arange(period // 2 + 1, dtype=torch.float64).clamp(min=1)
    power = step**-exponent
    twice = torch.full_like(power, 2.0)
    twice[0] = 1
    if period % 2 == 0:
        twice[-1] = 1
    power, twice = (part[: None if highest is None else highest + 1] for part in (power, twice))
    return power * period**2 / (twice * power).sum()


def function_and_options(noise: Noise) -> tuple[Callable[..., Tensor], dict[str, Any]]:
    """Return the function of a noise and the options that `functools.partial` bound to it."""
    return (noise.func, noise.keywords) if isinstance(noise, partial) else (noise, {})
