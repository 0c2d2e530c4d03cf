"""Noise of unit variance for sampled control sequences; planners multiply it by a standard deviation per control.

Every function draws [K, T, U] (samples, steps, controls) from a `torch.Generator`, on its device. Samples and controls
are independent; how steps are correlated depends on the function.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from offpiste.native.compilation import single_threaded_torch, spread_kernel

Shape = tuple[int, int, int]
"""Samples K, steps T, controls U."""

PART: Final = 32
"""Samples that have a generator of their own, so that noise does not depend on the number of threads."""

Noise = Callable[[Shape, Generator, torch.dtype], Tensor]
"""Type of the functions below, their options bound by `functools.partial`."""


def gaussian(shape: Shape, generator: Generator, dtype: torch.dtype = torch.float32) -> Float[Tensor, "K T U"]:
    """White noise: independent steps of variance 1 (Williams et al., 2017)."""
    return torch.randn(shape, generator=generator, dtype=dtype, device=generator.device)


def coloured(
    shape: Shape,
    generator: Generator,
    dtype: torch.dtype = torch.float32,
    *,
    exponent: float = 2.0,
    period: int | None = None,
    highest: int | None = None,
) -> Float[Tensor, "K T U"]:
    """Low-frequency noise: power 1 / f^exponent, variance 1 at every step (Vlahov et al., RA-L 2024).

    Drawn in the frequency domain (Timmer & Koenig, 1995), so the spectrum over the period is exact; the mean, f = 0,
    has the power of the lowest frequency.

    Args:
        exponent: 0 white, 1 pink, 2 like a random walk.
        period: number of steps after which the noise would repeat; 2 T by default, so that its end is not tied to its
            start.
        highest: highest frequency that is drawn [1 / period]; None for all. Fewer take less time.

    Raises:
        ValueError: the period is shorter than the steps.
    """
    steps = shape[1]
    period = 2 * steps if period is None else period
    size = coefficient_sizes(steps, exponent=exponent, period=period, highest=highest)
    return from_coefficients(shape, generator, size.to(generator.device, dtype), period)


def coefficient_sizes(
    steps: int, *, exponent: float = 2.0, period: int | None = None, highest: int | None = None
) -> Float[Tensor, " frequencies"]:
    """Root mean square of each coefficient that `coloured` draws (float64).

    Raises:
        ValueError: the period is shorter than the steps.
    """
    period = 2 * steps if period is None else period
    if period < steps:
        raise ValueError(f"noise of {steps} steps needs a period of at least as many, not {period}")
    power = spectrum(period, exponent, highest)
    # `irfft` reads only the real part of coefficients that are their own conjugates: it must have all of the power.
    power[0] *= 2
    if period % 2 == 0 and len(power) > period // 2:
        power[-1] *= 2
    return torch.sqrt(power)


def from_coefficients(
    shape: Shape, generator: Generator, size: Float[Tensor, " frequencies"], period: int
) -> Float[Tensor, "K T U"]:
    """Noise from random coefficients of these sizes.

    On the CPU in several threads: each part has a generator of its own, seeded by the one that is given.
    """
    if generator.device.type != "cpu":
        return _drawn(shape, generator, size, period)
    samples, steps, controls = shape
    seeds = torch.randint(2**62, (-(-samples // PART),), generator=generator).tolist()
    noise = torch.empty(samples, controls, steps, dtype=size.dtype).transpose(1, 2)

    def draw(first: int, last: int) -> None:
        for seed, part in zip(seeds[first:last], noise.split(PART)[first:last], strict=True):
            part.copy_(_drawn((len(part), steps, controls), Generator().manual_seed(seed), size, period))

    with single_threaded_torch():
        spread_kernel(len(seeds), draw)
    return noise


def _drawn(
    shape: Shape, generator: Generator, size: Float[Tensor, " frequencies"], period: int
) -> Float[Tensor, "K T U"]:
    samples, steps, controls = shape
    drawn = (samples, controls, len(size))
    parts = torch.randn(drawn, generator=generator, dtype=size.dtype.to_complex(), device=generator.device)
    return torch.fft.irfft(parts.mul_(size), n=period)[..., :steps].transpose(1, 2)


def spectrum(period: int, exponent: float, highest: int | None = None) -> Float[Tensor, " frequencies"]:
    """Mean square of each coefficient of `torch.fft.rfft` of one period of `coloured`, up to the highest (float64)."""
    step = torch.arange(period // 2 + 1, dtype=torch.float64).clamp(min=1)
    power = step**-exponent
    twice = torch.full_like(power, 2.0)
    twice[0] = 1
    if period % 2 == 0:
        twice[-1] = 1
    power, twice = (part[: None if highest is None else highest + 1] for part in (power, twice))
    return power * period**2 / (twice * power).sum()


def lifted(
    shape: Shape, generator: Generator, dtype: torch.dtype = torch.float32, *, noise: Noise = gaussian
) -> Float[Tensor, "K T U"]:
    """Smooth noise: the running sum of noise of the rates (Kim et al., smooth MPPI, 2022).

    Scaled so that it ends with variance 1: with white rates the variance of step t is (t + 1) / T, and one step's
    change is 1 / sqrt(T).
    """
    return noise(shape, generator, dtype).cumsum(dim=1) / math.sqrt(shape[1])


def function_and_options(noise: Noise) -> tuple[Callable[..., Tensor], dict[str, Any]]:
    """A noise's function, and the options that `functools.partial` bound."""
    return (noise.func, noise.keywords) if isinstance(noise, partial) else (noise, {})


def covariance(noise: Noise, steps: int) -> Float[Tensor, "T T"]:
    """Covariance of the steps of one control of Gaussian noise (float64), as it is drawn.

    Raises:
        ValueError: it is not known, or has no inverse.
    """
    function, options = function_and_options(noise)
    if function not in _COVARIANCES:
        name = getattr(function, "__name__", repr(function))
        known = ", ".join(of.__name__ for of in _COVARIANCES)
        raise ValueError(f"no covariance is known of the noise {name!r}, only of {known}")
    return _COVARIANCES[function](steps, **options)


def _white(steps: int) -> Tensor:
    return torch.eye(steps, dtype=torch.float64)


def _coloured(steps: int, *, exponent: float = 2.0, period: int | None = None, highest: int | None = None) -> Tensor:
    """Part of a circulant matrix, whose eigenvalues are the spectrum: those of the part lie between its extremes."""
    period = 2 * steps if period is None else period
    if highest is not None:
        raise ValueError(f"noise without frequencies above {highest} has no density: leave out `highest`")
    power = spectrum(period, exponent)
    if power.min() < 1e-10 * power.max():
        raise ValueError(f"the covariance of noise of exponent {exponent:g} over {period} steps has no exact inverse")
    lag = torch.arange(steps)
    return (torch.fft.irfft(power, n=period) / period)[(lag[:, None] - lag).abs()]


def _lifted(steps: int, *, noise: Noise = gaussian) -> Tensor:
    return covariance(noise, steps).cumsum(dim=0).cumsum(dim=1) / steps


_COVARIANCES: Final[dict[Noise, Callable[..., Tensor]]] = {gaussian: _white, coloured: _coloured, lifted: _lifted}
"""Covariance of each noise that is Gaussian, by steps and the noise's own options."""
