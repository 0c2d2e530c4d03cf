"""Simulated drives that an experiment needs, made once."""

from collections.abc import Callable
from pathlib import Path

from offpiste.simulation.simulate import DriveSettings, simulate


def simulate_once(settings: DriveSettings, log: Path, *, tell: Callable[[str], None]) -> None:
    """Record a drive unless it is there; what an interruption leaves has another name and is begun again."""
    if log.exists():
        return
    partial = log.with_name(f"{log.stem}.partial{log.suffix}")
    partial.unlink(missing_ok=True)
    driven = simulate(settings, partial)[0]
    partial.rename(log)
    tell(str(driven).replace(partial.name, log.name))
