"""From logs to a report of what seeing the ground is worth: features, models, evaluation and controls.

Each backbone has a folder with its PCA, dataset and runs; everything resumes.
"""

import logging
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from offpiste.core.errors import OffpisteError
from offpiste.core.parallel import at_a_time
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.place import drive_names
from offpiste.dataset.splits import parse_split, write_drives
from offpiste.evidence.controls import MODELS, run_controls
from offpiste.evidence.given import Drives, described, given_drives, inspect_drives
from offpiste.evidence.page import Collected, write_evidence
from offpiste.perception.backbones import BACKBONES, Backbone, open_backbone
from offpiste.perception.backbones.filterbank import FILTERBANK
from offpiste.perception.pca import save_pca
from offpiste.reproduction.data import opened, planned_drives, rig_of
from offpiste.reproduction.reproduce import reproduce
from offpiste.reproduction.results import gather
from offpiste.reproduction.runs import EvaluationData, figure_readings, mapped
from offpiste.reproduction.settings import PCA_SWEPT, ReproductionSettings, Size, defaults, figure_models
from offpiste.reproduction.steps import FEATURES, Step, append_time, claim_folder, run_steps
from offpiste.rig.rig import rig_text
from offpiste.simulation.recordings import Recording, simulate_all
from offpiste.training.run import load_run

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class EvidenceSettings:
    """Settings of `offpiste evidence`.

    Attributes:
        out: folder for everything.
        size: of trainings and evaluation; without logs, of the driving on the proving ground, too.
        logs: with cameras, LiDARs and commands; none: the proving ground is driven.
        rig: of the logs; name of a preset or a file.
        split: of the logs.
        weights: of a vision transformer, a folder or a name on the Hugging Face hub: a second backbone; "" for none.
        device: on which backbones and models run.
        processes: drives read, and runs trained, at a time; 0: one per core.
    """

    out: Path
    size: Size
    logs: tuple[str, ...] = ()
    rig: str = ""
    split: str = "blocks:0.7,0.1,0.2"
    weights: str = ""
    device: str = "cpu"
    processes: int = 0

    @property
    def at_a_time(self) -> int:
        """Number of processes (`parallel.at_a_time`)."""
        return at_a_time(self.processes, self.device)


@dataclass(frozen=True)
class Features:
    """A backbone that is compared.

    Attributes:
        name: in the report: that of the weights' folder, without its path, or on the hub.
        folder: below `out`: other weights have another one, wherever they lie.
    """

    backbone: Backbone
    name: str
    folder: str


def compared_features(weights: str, device: str) -> list[Features]:
    """`filterbank`, and the vision transformer of some weights, where they are given.

    Raises:
        OffpisteError: the weights are a backbone's name, or cannot be read.
    """
    first = Features(open_backbone(FILTERBANK, device=device), FILTERBANK, FILTERBANK)
    if not weights:
        return [first]
    if weights in BACKBONES:
        how = f"leave --weights out, for {FILTERBANK} is always compared, or give a vision transformer's folder"
        raise OffpisteError("names a backbone, not weights", where=f"--weights {weights}", how=how)
    place = Path(weights).resolve() if Path(weights).exists() else None
    backbone = open_backbone(str(place or weights), device=device)
    folder = f"{Path(place or weights).name}-{backbone.fingerprint[:8]}"
    name = place.name if place is not None else weights
    return [first, Features(backbone, folder if name == FILTERBANK else name, folder)]


def collect(settings: EvidenceSettings) -> Path:
    """Extract, train, evaluate and write the report.

    Returns:
        Path of report.html, one file that needs nothing but itself.

    Raises:
        OffpisteError: logs without a rig or the other way round, or a stage failed.
    """
    if bool(settings.logs) != bool(settings.rig):
        what = "logs are given without their rig" if settings.logs else "a rig is given without logs"
        raise OffpisteError(what, how="give both, or neither to drive on the proving ground")
    features = compared_features(settings.weights, settings.device)
    drives = _claimed(settings)
    collected = {}
    for number, each in enumerate(features, start=1):
        folder = settings.out / each.folder
        logger.info(f"{each.name}, backbone {number} of {len(features)}: features, trainings, evaluation, controls")
        record = partial(append_time, folder / "steps.jsonl")
        run_steps(_data_steps(settings, drives, each, folder), of="the features", record=record)
        collected[each.name] = _compared(settings, folder)
    page = write_evidence(collected, settings.out, rig=rig_text(settings.rig) if settings.rig else "")
    logger.info(f"report to send back: {page}")
    return page


def _claimed(settings: EvidenceSettings) -> Drives:
    """The drives, inspected before the folder is begun with them, or simulated into it."""
    if not settings.logs:
        claim_folder(settings.out, described(settings.size, None, ""), defaults=defaults(), own=FEATURES)
        drives = _simulated(settings)
        _drive(settings, drives)
        return drives
    drives = given_drives(settings.logs, settings.rig, settings.split)
    if not (settings.out / "settings.json").exists():
        inspect_drives(drives, rig=settings.rig)
    claim_folder(settings.out, described(settings.size, drives, settings.rig), defaults=defaults(), own=FEATURES)
    return drives


def _simulated(settings: EvidenceSettings) -> Drives:
    planned = planned_drives(settings.size)
    logs = tuple(str(settings.out / "logs" / f"{drive.name}.mcap") for drive in planned)
    parts = tuple((drive.name, drive.part) for drive in planned)
    return Drives(logs, rig_of(settings.size), write_drives(settings.out / "parts.txt", parts))


def _drive(settings: EvidenceSettings, drives: Drives) -> None:
    planned = planned_drives(settings.size)
    recordings = [Recording(drive.settings, Path(log)) for drive, log in zip(planned, drives.logs, strict=True)]
    if any(not recording.log.exists() for recording in recordings):
        simulate_all(recordings, settings.at_a_time)


def _data_steps(settings: EvidenceSettings, drives: Drives, features: Features, folder: Path) -> list[list[Step]]:
    backbone, name = features.backbone, features.name
    pca, dataset = folder / "pca.safetensors", folder / "dataset.zarr"

    def fit() -> None:
        fitted = fit_pca(
            drives.logs,
            drives.rig,
            parse_split(drives.split),
            backbone,
            images=settings.size.images,
            components=min(max(PCA_SWEPT), backbone.channels),
            processes=settings.at_a_time,
        )
        save_pca(pca, fitted.pca)

    def extract() -> None:
        make_dataset(
            drives.logs,
            drives.rig,
            dataset,
            split=drives.split,
            pca=pca,
            device=settings.device,
            snapshots=SnapshotSettings(settings.size.snapshot_seconds),
            processes=settings.at_a_time,
        )

    def extracted() -> bool:
        return dataset.exists() and len(drive_names(dataset)) == len(drives.logs)

    count = len(drives.logs)
    return [
        [Step(f"{name}: fit the PCA", 10.0 + 5 * count, pca.exists, fit)],
        [Step(f"{name}: extract {count} drive{'s' * (count > 1)}", 20.0 * count, extracted, extract)],
    ]


def _compared(settings: EvidenceSettings, folder: Path) -> Collected:
    """The paper's models, trained on the folder's dataset and evaluated, and controls of the gains."""
    of = ReproductionSettings(
        "fig4",
        settings.size,
        folder,
        dataset=folder / "dataset.zarr",
        device=settings.device,
        processes=settings.processes,
    )
    reproduce(of)
    data = EvaluationData(of, opened(of))
    models = figure_models("fig4", len(data.dataset.features))
    results = gather(of, models, figure_readings("fig4", mapped=mapped(data.dataset)))
    runs = {
        model.label: [load_run(of.runs / model.folder(seed)) for seed in range(of.size.seeds)]
        for model in models
        if model.label in MODELS
    }
    kept = folder / "controls"
    controls = run_controls(data.dataset, runs, stride=of.size.stride, scale=data.scale, kept=kept)
    return Collected(of, data, results, controls)
