"""`offpiste evidence`."""

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS

if TYPE_CHECKING:
    from offpiste.evidence.collect import EvidenceSettings


@COMMANDS.register("evidence")
@dataclass(frozen=True)
class Evidence:
    """Find out what seeing the ground is worth on logs of a vehicle, with controls, in one report; resumes."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="[LOG...]")] = ()
    """Logs with cameras, LiDARs and commands; without any, the proving ground is driven (needs the extra `sim`)."""
    rig: str = ""
    """Rig of the logs: a preset or a file."""
    weights: str = ""
    """Weights of DINOv2 or another vision transformer: a folder, or owner/model on the Hugging Face hub. Its features
    are compared beside those of `filterbank`, which needs none."""
    split: str = "blocks:0.7,0.1,0.2"
    """Which stretches of the logs train, validate and test, as in `extract`."""
    size: Literal["smoke", "laptop", "paper"] = "laptop"
    """Amount of training; without logs, of driving, too."""
    seeds: int | None = None
    """Runs of every model, instead of the size's."""
    out: Path = Path("evidence")
    """Folder for everything."""
    device: str = "cpu"
    """Device of the backbones and the models."""
    processes: int = 0
    """Drives read, and runs trained, at a time; 0: one a core."""

    def run(self) -> int:
        """Extract, train, evaluate, write the report."""
        from offpiste.evidence.collect import collect

        # As Ctrl-C: workers are ended, and a line says that what was finished is kept.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            collect(self._settings())
        finally:
            signal.signal(signal.SIGTERM, before)
        return 0

    def _settings(self) -> "EvidenceSettings":
        from offpiste.evidence.collect import EvidenceSettings
        from offpiste.reproduction.settings import sized

        return EvidenceSettings(
            out=self.out,
            size=sized(self.size, None, self.seeds),
            logs=self.logs,
            rig=self.rig,
            split=self.split,
            weights=self.weights,
            device=self.device,
            processes=self.processes,
        )
