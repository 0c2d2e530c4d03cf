"""Features of other ground: what is left of a reproduction's gains (`offpiste.reproduction.shift`)."""

import logging
from pathlib import Path

from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import percent, write_control
from offpiste.reproduction.results import gain_table
from offpiste.reproduction.shift import shift_gains

logger = logging.getLogger("experiments")


def shift_control(of: Reproduced, out: Path) -> Path:
    """Evaluate the reproduction's runs with features from elsewhere."""
    runs = {model: of.runs(model) for model in of.present(("b", "cf", "dc", "df"))}
    found = shift_gains(of.dataset, runs, stride=of.size.stride, scale=of.scale, kept=out / "evaluated")
    for here, moved in zip(found.gains[::3], found.gains[1::3], strict=True):
        where = " ".join(filter(None, (here.lookup, here.feature_set)))
        logger.info(f"{here.model}, {where}: {percent(here.distance)}, shifted {percent(moved.distance)}")
    table = gain_table("Features shifted along the path", found.gains, found.about)
    numbers = {"control": "shift", "metres": found.metres, "other_ground": found.ground, "gains": found.gains}
    return write_control(out / "shift", [table], numbers)
