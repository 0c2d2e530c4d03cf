"""Which models a figure is of, and which of them are the same."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from offpiste.conventions import FEATURE_SETS
from offpiste.evaluation.results import label
from offpiste.experiments.reproduce.settings import Figure, Size
from offpiste.training.config import TrainConfig

CODES, PCA = 4, 40
"""The paper's n and its number of PCA features."""

CODES_SWEPT = (1, 2, 4, 8, 16)
PCA_SWEPT = (5, 10, 20, 40, 80)
"""Fig. 3b and 3c."""

SEEDED = ("b", "cf", "dc")
"""Models with several seeds."""


@dataclass(frozen=True)
class Member:
    """A model of a figure.

    Attributes:
        model: its name in `offpiste.dynamics.MODELS`.
        codes: length of its code.
        pca: how many of the dataset's features it reads.
        variant: what tells it from the usual one of its name; empty for that one.
    """

    model: str
    codes: int
    pca: int
    variant: str = ""

    @property
    def label(self) -> str:
        """Name and variant."""
        return label(self.model, self.variant)

    def folder(self, seed: int) -> str:
        """Name of a run's folder."""
        return "-".join((self.model, *filter(None, (self.variant.replace(" ", "-").replace("=", ""),)), str(seed)))

    def config(self, size: Size, seed: int, device: str) -> TrainConfig:
        """Settings of its training."""
        return replace(size.train, model=self.model, codes=self.codes, pca=self.pca, seed=seed, device=device)

    def seeds(self, size: Size) -> range:
        """Of its runs."""
        return range(size.seeds if self.model in SEEDED and not self.variant else 1)


def usual(model: str, stored: int) -> Member:
    """A model as in the paper, or with as many features as there are."""
    return Member(model, CODES, min(PCA, stored))


def compression_sizes(stored: int) -> dict[int, Member]:
    """Fig. 3b: `cf` by the length of its code."""
    same = usual("cf", stored)
    return {n: same if n == CODES else replace(same, codes=n, variant=f"n={n}") for n in CODES_SWEPT}


def feature_numbers(stored: int) -> dict[int, Member]:
    """Fig. 3c: `cf` by the number of features that it reads; none beyond what the dataset stores."""
    same = usual("cf", stored)
    numbers = sorted({min(n, stored) for n in PCA_SWEPT})
    return {n: same if n == same.pca else replace(same, pca=n, variant=f"pca={n}") for n in numbers}


def members(figure: Figure, stored: int) -> list[Member]:
    """The models of a figure, `b` first, each once.

    Args:
        stored: how many features the dataset has.
    """
    if figure == "fig4":
        return [usual(name, stored) for name in ("b", "df", "cf", "dc")]
    swept = [*compression_sizes(stored).values(), *feature_numbers(stored).values()]
    return list(dict.fromkeys([usual(name, stored) for name in ("b", "df", "cf")] + swept))


def feature_sets(figure: Figure) -> Sequence[str]:
    """That models read at recorded places."""
    return FEATURE_SETS if figure == "fig4" else FEATURE_SETS[:1]
