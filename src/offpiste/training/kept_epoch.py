"""The epoch that a stage of training keeps, and what to doubt about it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

FEW_WINDOWS: Final = 200
"""Validation windows below which the choice of an epoch is a matter of chance: 200 overlapping ones are some 10 s."""
_RECENT: Final = 3
"""Last epochs whose gain says whether a stage has converged."""
_CONVERGED: Final = 0.01
"""Share of the validation loss that they take off, below which it has."""
SETTINGS: Final = {"bicycle": "bicycle_epochs", "model": "epochs"}
"""Settings that give the stages their epochs, of those that may not have converged."""


@dataclass(frozen=True)
class KeptEpoch:
    """The epoch of the least validation loss.

    Attributes:
        epoch: its number from 1; 0: the weights that the stage began with. None of runs that did not note it.
        epochs: of the stage.
        validation_loss: of that epoch; None of runs that did not note it.
        gained: share of the validation loss that the last epochs took off; None where there were too few to say.
    """

    epoch: int | None
    epochs: int
    validation_loss: float | None
    gained: float | None = None

    @classmethod
    def of(cls, about: dict[str, Any], epochs: int) -> "KeptEpoch":
        """From what a stage's file says beside its weights; without a gain, as files of before, it is not doubted."""
        epoch, loss, gained = about.get("kept_epoch"), about.get("validation_loss"), about.get("gained", 0.0)
        return cls(
            None if epoch is None else int(epoch),
            epochs,
            None if loss is None else float(loss),
            None if gained is None else float(gained),
        )

    @classmethod
    def last_of(cls, epoch: int | None, losses: Sequence[float], epochs: int, best: float) -> "KeptEpoch":
        """From the validation losses of a stage's epochs."""
        before = min(losses[:-_RECENT], default=None)
        return cls(epoch, epochs, best, None if not before else max(1 - best / before, 0.0))

    @property
    def has_converged(self) -> bool:
        """Whether another epoch was better than the last, or the last ones hardly better than those before."""
        gains = self.gained is None or self.gained > _CONVERGED
        return not (self.epoch == self.epochs > 1 and gains)

    def about(self) -> dict[str, Any]:
        """What a stage's file says beside its weights."""
        return {"validation_loss": self.validation_loss, "kept_epoch": self.epoch, "gained": self.gained}

    def line(self, stage: str) -> str:
        """In words."""
        loss = "validation not noted" if self.validation_loss is None else f"validation {self.validation_loss:.4f}"
        if self.epoch is None:
            return f"{stage}: kept its best epoch, {loss}"
        if self.epoch == 0:
            return f"{stage}: kept the weights that it began with, {loss}: no epoch of {self.epochs} was better"
        return f"{stage}: kept epoch {self.epoch} of {self.epochs}, {loss}"

    def doubts(self, stage: str) -> Iterator[str]:
        """What speaks against it; nothing of the actuators, whose last bit of convergence no model shows."""
        if stage not in SETTINGS:
            return
        if not self.has_converged:
            yield (
                f"{stage}: the kept epoch is the last one: it may not have converged; train again, into another --out, "
                f"with more than {self.epochs} --{SETTINGS[stage].replace('_', '-')}"
            )
        elif self.epoch == 1 and self.epochs > 1:
            yield (
                f"{stage}: the kept epoch is the first one: validation may be unlike training, or the learning rate "
                "too high"
            )
