"""A trained run as a planner: its model and feature extractor."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from offpiste.core.checksums import sha256_of
from offpiste.core.errors import RunError
from offpiste.core.limits import parsed, read_small
from offpiste.core.shipped import PCA, PREFIX
from offpiste.dynamics import Dynamics
from offpiste.logs.ground_truth import GROUND_PROPERTIES
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.training.checkpoint import WEIGHTS, load_json
from offpiste.training.run import Run, load_run
from offpiste.uncertainty.fit import FILE, load_spread
from offpiste.uncertainty.novelty import Novelty, load_memory_bank, mask_novel_ground
from offpiste.uncertainty.spread import Spread


@dataclass(frozen=True)
class Planner:
    """A trained model and what it needs to drive."""

    name: str  # name of the model; "ceiling" if it is given the simulator's ground properties
    folder: Path  # folder of the run
    dynamics: Dynamics
    extractor: FeatureExtractor | None = None  # backbone and PCA; None if the model reads no visual features
    weights: str = ""  # hash of the weights, as a run may be trained again in its folder
    seed: int = 0  # seed of the training
    novelty: Novelty = "ignored"  # treatment of ground unlike any in training
    spread: Spread | None = None  # spread of the predictions; None without `offpiste calibrate`

    @property
    def knows_ground(self) -> bool:
        """Whether the model is given the ground's true properties."""
        return self.extractor is None and self.dynamics.encoder is not None


def load_planner(
    folder: str | Path, pca: Path | None = None, *, novelty: Novelty = "ignored", device: str = "cpu"
) -> Planner:
    """Load a run and, if its model reads visual features, its feature extractor.

    Args:
        folder: folder of the run, or `pretrained:NAME`.
        pca: PCA file of the run's dataset; shipped models have their own.
        novelty: "missing" treats ground unlike any in training as ground without features.
        device: device of the feature extractor; the model is on the CPU.

    Raises:
        RunError: no such run; the PCA is missing or differs from that of training; the spread belongs to other weights;
            or novelty needs features or a memory bank that the run lacks.
        PerceptionError: not a PCA, or its backbone is not available.
    """
    run = load_run(folder)
    missing = [name for name in ("throttle", "steer") if name not in run.dynamics.vehicle.control]
    if missing:
        raise RunError(
            f"was trained without the {' and the '.join(missing)} that a planner would choose",
            where=folder,
            how="give a run trained on commands of both",
        )
    ships, folder = str(folder).startswith(PREFIX), run.folder
    planner = _without_features(run)
    if run.dynamics.encoder is None:
        if novelty == "missing":
            raise RunError("reads no features, so no ground is novel to it", where=folder, how="leave --novelty out")
        return planner
    if novelty == "missing":
        mask_novel_ground(run.dynamics, load_memory_bank(run))
        planner = replace(planner, novelty=novelty)
    identity, features = (run.pca, run.features) if run.features else _of_dataset(folder)
    if identity is None:
        _refuse_unknown(features, folder)
        return replace(planner, name="ceiling")
    if pca is None and ships:
        pca = folder.parent / PCA
    if pca is None:
        raise RunError("reads visual features", where=folder, how="give --pca, the file its dataset was extracted with")
    extractor = load_feature_extractor(pca, device)
    if extractor.identity != identity:
        raise RunError(
            f"was trained with another PCA ({identity}) than {pca} ({extractor.identity})",
            where=folder,
            how="give the file that its dataset was extracted with",
        )
    return replace(planner, extractor=extractor)


def _without_features(run: Run) -> Planner:
    weights = sha256_of(run.folder / WEIGHTS)[:16]
    spread = load_spread(run) if (run.folder / FILE).exists() else None
    return Planner(run.model, run.folder, run.dynamics, weights=weights, seed=run.seed, spread=spread)


def _of_dataset(folder: Path) -> tuple[str | None, tuple[str, ...]]:
    """Identity of the PCA and feature names of a run's dataset, for old runs that do not store them."""
    about: dict[str, Any] = load_json(folder / "model.json")
    if about.get("pca") is not None:
        return str(about["pca"]), ()
    dataset = Path(about.get("dataset", ""))
    try:
        attributes = parsed(read_small(dataset / "zarr.json"))["attributes"]
        return attributes["pca"], tuple(attributes["features"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(
            f"its dataset {dataset} is needed to tell which features it reads, and cannot be read",
            where=folder,
            how="put the dataset back where it was",
        ) from error


def _refuse_unknown(features: tuple[str, ...], folder: Path) -> None:
    """Raise unless features without a PCA are the true properties of the ground."""
    if features != GROUND_PROPERTIES:
        raise RunError(
            f"reads features that cameras do not provide: {', '.join(features[:4])} …",
            where=folder,
            how="give a run trained on visual features, on ground-truth ones, or on none",
        )
