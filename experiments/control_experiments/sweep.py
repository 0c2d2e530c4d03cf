"""Gain against grip contrast, and against variation of appearance that is independent of grip.

Cheap: drives without cameras; features are the true kinds of ground and wetness, with smooth noise of a stated size in
the place of imperfect vision. Expensive: drives with cameras and the reproduction's PCA.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.figure import Figure

from experiments.control_experiments.data import driven_dataset, planned
from experiments.control_experiments.models import trained_seeds
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from offpiste.dataset.ground_truth_features import LAYERS, truth_map, with_ground_truth
from offpiste.dataset.resample import Rows
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.reproduction.gains import MAP, Gain, errors_of, evaluation_index, gain, gain_table
from offpiste.simulation.world.noise import smooth_noise

logger = logging.getLogger("experiments")

FIRST_SEED = 4000
GRAIN = 3.0
"""Grain of the noise in the place of imperfect sight [m]: spots of about 9 m, as patches of ground are."""


@dataclass(frozen=True)
class Sweep:
    """What is swept.

    Attributes:
        contrasts: values of the grip contrast, at the usual appearance.
        appearances: at full contrast: with `visual`, `appearance_noise` of the worlds; else standard deviation of noise
            in units of each feature's own.
        visual: cameras and the reproduction's PCA; else true kinds and wetness.
        world: preset.
        train, validation, test: lengths of drives of each condition [s].
    """

    contrasts: tuple[float, ...] = (0.0, 0.5, 1.0)
    appearances: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0)
    visual: bool = False
    world: str = "mojave"
    train: tuple[float, ...] = (120.0, 120.0, 120.0)
    validation: tuple[float, ...] = (90.0,)
    test: tuple[float, ...] = (45.0, 45.0, 45.0, 45.0)


def sweep_control(of: Reproduced, out: Path, kind: str, sweep: Sweep, seeds: int) -> Path:
    """Simulate, train and evaluate at every value of "contrast" or "appearance"."""
    by_contrast, gains = kind == "contrast", []
    values = sweep.contrasts if by_contrast else sweep.appearances
    for value in values:
        contrast, looks = (value, 1.0 if sweep.visual else 0.0) if by_contrast else (1.0, value)
        mine = _condition(of, out / "sweeps", sweep, contrast, looks, seeds)
        gains += [(value, _named(g, f"{kind} {value:g}")) for g in mine]
        logger.info(f"{kind} {value:g}: " + ", ".join(f"{g.model} {g.distance.mean:+.1%}" for g in mine))
    name = f"{kind}-visual" if sweep.visual else kind
    table = gain_table(f"Gain against {kind}", [g for _, g in gains], _about(sweep))
    results = {"control": name, "sweep": sweep, "gains": [{"value": value, "gain": g} for value, g in gains]}
    axis = (
        "grip contrast" if by_contrast else ("appearance noise" if sweep.visual else "noise in units of the features")
    )
    return write_control(out / name, [table], results, {name: draw_gains(gains, axis)})


def _named(result: Gain, case: str) -> Gain:
    """The same under another name."""
    return msgspec.structs.replace(result, case=case)


def _condition(of: Reproduced, folder: Path, sweep: Sweep, contrast: float, looks: float, seeds: int) -> list[Gain]:
    lengths = (sweep.train, sweep.validation, sweep.test)
    appearance, noise = (looks, 0.0) if sweep.visual else (1.0, looks)
    sensors = "light" if sweep.visual else "none"
    drives = planned(sweep.world, lengths, seed=FIRST_SEED, sensors=sensors, contrast=contrast, appearance=appearance)
    place = folder / f"{'visual' if sweep.visual else 'kinds'}-contrast{contrast:g}-appearance{appearance:g}"
    if sweep.visual:
        dataset = driven_dataset(drives, place, pca=of.pca, snapshot_seconds=of.size.snapshot_seconds)
    else:
        dataset = driven_dataset(drives, place, features="ground-kind")
        if noise:
            dataset = with_noise(dataset, [place / "logs" / f"{d.name}.mcap" for d in dataset.drives], noise)
    models = ("b", "cf", "dc") if sweep.visual else ("b", "df")
    config = replace(of.size.train, seed=0, pca=min(of.member("cf").pca, len(dataset.features)))
    runs = {}
    for model in models:
        own = place / (f"runs-noise{noise:g}" if noise and model != "b" else "runs")
        runs[model] = trained_seeds(dataset, replace(config, model=model), own, seeds, stages=place / "runs")
    windows, scale = Windows(dataset, "test"), runs["b"][0].scale
    index = evaluation_index(windows, MAP, of.size.stride)
    errors = {
        model: [
            errors_of(run, windows, index, MAP, scale=scale, kept=run.folder.parent.parent / f"evaluated-{noise:g}")
            for run in mine
        ]
        for model, mine in runs.items()
    }
    return [gain("", model, errors[model], errors["b"], MAP) for model in models[1:]]


def with_noise(dataset: Dataset, logs: Sequence[Path], noise: float) -> Dataset:
    """A dataset of true kinds of ground with smooth noise on every feature, the same under wheels and on maps.

    Args:
        logs: of the drives, in their order.
        noise: standard deviation in units of each feature's own on the drive's map.
    """
    drives = []
    for number, (drive, log) in enumerate(zip(dataset.drives, logs, strict=True)):
        seen = noisy(truth_map(log, LAYERS["ground-kind"]), noise, np.random.default_rng([FIRST_SEED, number]))
        rows, terrain = with_ground_truth(replace(drive.rows, cells=None), seen, dataset.rig)
        drives.append(_with(drive, rows, terrain))
    return replace(dataset, drives=tuple(drives))


def _with(drive: StoredDrive, rows: Rows, terrain: TerrainMap) -> StoredDrive:
    return replace(drive, rows=rows, load_map=(lambda: terrain) if drive.load_map is not None else None)


def noisy(terrain: TerrainMap, noise: float, rng: np.random.Generator) -> TerrainMap:
    """A map with smooth noise on its features, of `noise` times each one's standard deviation."""
    ny, nx, count = terrain.features.shape
    x, y = (terrain.resolution * np.arange(n) for n in (nx, ny))
    spread = np.nanstd(terrain.features.reshape(-1, count).astype(np.float64), axis=0)
    fields = np.stack([smooth_noise(rng, x, y, GRAIN) for _ in range(count)], axis=-1)
    return replace(terrain, features=(terrain.features + noise * spread * fields).astype(np.float32))


def _about(sweep: Sweep) -> str:
    sight = (
        "visual features of `light` cameras with the reproduction's PCA"
        if sweep.visual
        else "the true kinds of ground and wetness in the place of visual features, with smooth noise where stated"
    )
    return (
        f"World {sweep.world}, {sight}. Trained and evaluated anew at each value, on the map at predicted places, "
        "against b; 95 % intervals."
    )


def draw_gains(gains: Sequence[tuple[float, Gain]], axis: str) -> Figure:
    """Distance error relative to b against a value, a line a model."""
    figure = Figure(figsize=(5.2, 3.6), layout="constrained")
    axes = figure.subplots()
    for number, model in enumerate(dict.fromkeys(g.model for _, g in gains)):
        mine = [(value, g.distance) for value, g in gains if g.model == model]
        at, mean = np.array([(value, 100 * d.mean) for value, d in mine]).T
        bounds = 100 * np.array([d.ci95 for _, d in mine]).T
        reach = np.nan_to_num(np.abs(bounds - mean))
        axes.errorbar(at, mean, yerr=reach, marker="o", capsize=3, label=model, color=f"C{number}")
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set(xlabel=axis, ylabel="distance error after 5 s against b [%]")
    axes.grid(color="#e5e5e5", linewidth=0.5)
    axes.legend(frameon=False)
    return figure
