"""What a reproduction of the paper's figures left in its folder: drives, dataset, trained runs and their settings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import torch

from offpiste.core.errors import RunError
from offpiste.dataset.splits import write_drives
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.inspection.extract import extract
from offpiste.reproduction.settings import FigureModel, Size, standard_model
from offpiste.training.checkpoint import load_json
from offpiste.training.run import Run, load_run


@dataclass(frozen=True)
class Reproduced:
    """A finished reproduction.

    Attributes:
        folder: of `offpiste reproduce`.
        size: size of the evaluation, and settings of the training.
        dataset: with visual features by distance.
    """

    folder: Path
    size: Size
    dataset: Dataset

    @property
    def pca(self) -> Path:
        """That the features were made with."""
        return self.folder / "pca.safetensors"

    @property
    def scale(self) -> torch.Tensor:
        """Units of the loss, the same for all runs."""
        return self.runs("b")[0].scale

    def runs(self, model: str) -> list[Run]:
        """All seeds of a model.

        Raises:
            RunError: there is none.
        """
        result = sorted(self.folder.glob(f"runs/{model}-[0-9]*/model.json"))
        if not result:
            raise RunError(
                f"has no finished run of '{model}'", where=self.folder, how="run `offpiste reproduce fig4` to its end"
            )
        return [load_run(path.parent) for path in result]

    def present(self, models: Sequence[str]) -> list[str]:
        """Those of some models that were trained, in their order."""
        return [model for model in models if any(self.folder.glob(f"runs/{model}-[0-9]*/model.json"))]

    def member(self, model: str) -> FigureModel:
        """A model as the reproduction would train it."""
        return standard_model(model, len(self.dataset.features))

    def logs(self) -> list[Path]:
        """Logs of all drives of the dataset.

        Raises:
            RunError: one is missing, as where the size removes them.
        """
        if self.size.portion:
            what = f"keeps no logs of size '{self.size.name}'"
            raise RunError(what, where=self.folder, how="run this control on a reproduction of another size")
        logs = [self.folder / "logs" / f"{drive.name}.mcap" for drive in self.dataset.drives]
        missing = [log for log in logs if not log.exists()]
        if missing:
            raise RunError("a drive's log is missing", where=missing[0], how="run `offpiste reproduce` again")
        return logs

    def true_ground(self, folder: Path) -> Dataset:
        """The true `logs.ground_truth.GROUND_PROPERTIES` under the wheels of the same drives.

        Args:
            folder: where they are extracted to if the reproduction does not keep them.
        """
        if (kept := self.folder / "truth.zarr").exists():
            truth = open_dataset(kept)
        else:
            split, out = self.dataset.split, folder / "dataset.zarr"
            text = write_drives(folder / "parts.txt", split.drives) if split.kind == "drives" else split.text
            truth = extract(self.logs(), self.dataset.rig, out, split=text, features="ground-truth", force=True)
        return truth.starting_above(self.size.train.min_speed)


def open_reproduction(folder: Path) -> Reproduced:
    """A reproduction's folder.

    Raises:
        RunError: it is none.
        DatasetError: its dataset is missing or damaged.
    """
    settings: dict[str, Any] = load_json(folder / "settings.json")
    try:
        size, made_of = msgspec.convert(settings["size"], type=Size), settings["dataset"]
    except (KeyError, msgspec.ValidationError) as error:
        raise RunError(
            f"lacks or misstates {error}", where=folder / "settings.json", how="give the folder of `offpiste reproduce`"
        ) from error
    path = folder / "dataset.zarr" if made_of == "simulated" else Path(made_of)
    dataset = open_dataset(path).starting_above(size.train.min_speed)
    return Reproduced(folder, size, dataset)
