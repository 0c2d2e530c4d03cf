"""Low-frequency noise of unit variance for sampled control sequences."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from offpiste.native.threads import single_threaded_torch, spread_kernel

Shape = tuple[int, int, int]
"""Samples K, steps T, controls U."""

PART: Final = 32
"""Samples per generator, so that the noise does not depend on the number of threads."""

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

    Args:
        exponent: 0 white, 1 pink, 2 like a random walk.
        period: period of the noise [steps]; 2 T by default, so that its end does not depend on its start.
        highest: highest frequency drawn [1 / period]; None for all.

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
    """Return the root mean square of each coefficient that `coloured` draws (float64).

    Raises:
        ValueError: the period is shorter than the steps.
    """
    period = 2 * steps if period is None else period
    if period < steps:
        raise ValueError(f"the period of noise ({period}) must be at least the number of steps ({steps})")
    power = spectrum(period, exponent, highest)
    # `irfft` reads only the real part of the first and the last coefficient, which must have all of the power.
    power[0] *= 2
    if period % 2 == 0 and len(power) > period // 2:
        power[-1] *= 2
    return torch.sqrt(power)


def from_coefficients(
    shape: Shape, generator: Generator, size: Float[Tensor, " frequencies"], period: int
) -> Float[Tensor, "K T U"]:
    """Draw noise with coefficients of these root mean squares, in several threads on the CPU."""
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
