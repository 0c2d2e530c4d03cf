"""Control experiments on a finished `offpiste reproduce fig4` (docs/control-experiments.md)."""

import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.command import run
from experiments.control_experiments.oracle import oracle_control
from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.strata import strata_control
from offpiste.reproduction.steps import claim_folder

logger = logging.getLogger("experiments")

What = Literal["oracle", "strata"]


@dataclass(frozen=True)
class ControlExperiment:
    """Run a control experiment on a finished `offpiste reproduce fig4`; results already in --out are reused."""

    what: Annotated[What, tyro.conf.Positional]
    """Name of the experiment (docs/control-experiments.md)."""
    reproduction: Path = Path("results")
    """Folder of a finished `offpiste reproduce fig4`."""
    out: Path = Path("controls")
    """Folder of all outputs."""
    seeds: int = 3
    """Number of runs of each model that is trained."""

    def run(self) -> None:
        """Run the experiment, and show its tables."""
        of = open_reproduction(self.reproduction)
        # Evaluations in the folder are reused: they must belong to the same runs.
        size = {"size": {key: value for key, value in asdict(of.size).items() if key != "seeds"}}  # they may grow
        claim_folder(self.out, {"reproduction": str(self.reproduction.resolve()), **size})
        experiments: dict[What, Callable[[], Path]] = {
            "oracle": lambda: oracle_control(of, self.out, self.seeds),
            "strata": lambda: strata_control(of, self.out),
        }
        page = experiments[self.what]()
        logger.info(page.read_text("utf-8"))
        logger.info(f"written: {page}")


if __name__ == "__main__":
    run(ControlExperiment)
