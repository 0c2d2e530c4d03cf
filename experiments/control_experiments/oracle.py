"""Oracle: gain of models that are given the true ground, and the share of it that visual features reach."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.runs import trained_seeds
from experiments.gains import errors_of, gain, gain_table, runs_of, same_windows, share, write_control
from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import Sampling, percent
from offpiste.report.text_table import TextTable
from offpiste.reproduction.results import HINDSIGHT, MAP
from offpiste.reproduction.runs import evaluation_windows

ABOUT = (
    "The oracle is df on the true friction, cornering stiffness, rolling resistance and sinkage drag; its baseline is "
    "a b that reads the true normals. Both are trained on the same drives and evaluated on the same windows, on the "
    "whole true map at predicted places, or at recorded places."
)
SHARES = (
    "Part of the oracle's relative gain in distance error that a model reaches, each against the b with the same "
    "normals; 95 % intervals. Recorded sets are compared with the oracle at recorded places."
)


def oracle_control(of: Reproduced, out: Path, seeds: int) -> Path:
    """Train b and df on the truth, evaluate them on the reproduction's windows, and compare its runs with them."""
    folder, scale, stride = out / "oracle", of.scale, of.size.stride
    truth = of.true_ground(folder)
    config = replace(of.size.train, seed=0)
    knowing = {m: trained_seeds(truth, replace(config, model=m), folder / "runs", seeds) for m in ("b", "df")}
    windows, true_windows = Windows(of.dataset, "test"), Windows(truth, "test")
    models = of.present(("cf", "dc", "df"))
    gains, lines = [], []
    oracle: dict[tuple[str, Reading], list[Errors]] = {}
    for reading in [MAP, *(("recorded", name) for name in FEATURE_SETS)]:
        index = evaluation_windows(windows, reading, stride)
        there, of_truth = same_windows(windows, index, true_windows), MAP if reading == MAP else HINDSIGHT
        if ("b", of_truth) not in oracle:
            for model, runs in knowing.items():
                kept = out / "evaluated" / "oracle"
                oracle[model, of_truth] = [
                    errors_of(run, true_windows, there, of_truth, scale=scale, kept=kept) for run in runs
                ]
            gains.append(gain("true ground", "oracle", oracle["df", of_truth], oracle["b", of_truth], of_truth))

        def errors(model: str, reading: Reading = reading, index: np.ndarray = index) -> list[Errors]:
            return [
                errors_of(run, windows, index, reading, scale=scale, kept=out / "evaluated") for run in of.runs(model)
            ]

        blind = errors("b")
        for model in models:
            mine = errors(model)
            gains.append(gain("", model, mine, blind, reading))
            all_four = (mine, blind, oracle["df", of_truth], oracle["b", of_truth])
            seeds = min(map(len, all_four))
            own, base, best, best_base = (runs_of(each[:seeds]) for each in all_four)
            reached = share(own, base, best, best_base, Sampling().on(best))
            lines.append((model, " ".join(filter(None, reading)), percent(reached), reached))
    table = TextTable("Share of the oracle's gain", ("model", "lookup", "share"), tuple(x[:3] for x in lines), SHARES)
    shares = [{"model": model, "way": reading, "share": reached} for model, reading, _, reached in lines]
    results = {"control": "oracle", "gains": gains, "shares": shares}
    return write_control(folder, [table, gain_table("Gains over b", gains, ABOUT)], results)
