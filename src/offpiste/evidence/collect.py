"""From logs to a report of what seeing the ground is worth: features, models, evaluation and controls.

Each backbone has a folder with its PCA, dataset and runs; everything resumes.
"""

import hashlib
import logging
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from offpiste.dataset.extract import make_dataset
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.place import drive_names
from offpiste.dataset.splits import parse_split, write_drives
from offpiste.errors import OffpisteError
from offpiste.evidence.controls import MODELS, run_controls
from offpiste.evidence.page import Collected, write_evidence
from offpiste.object_store import expanded
from offpiste.parallel import usable_cores
from offpiste.perception.backbones import Backbone, open_backbone
from offpiste.perception.pca import save_pca
from offpiste.reproduction.data import opened, planned_drives, rig_of
from offpiste.reproduction.reproduce import reproduce
from offpiste.reproduction.results import gather
from offpiste.reproduction.runs import EvaluationData, figure_readings, mapped
from offpiste.reproduction.settings import PCA_SWEPT, ReproductionSettings, Size, figure_models
from offpiste.reproduction.steps import Step, append_time, claim_folder, run_steps
from offpiste.rig.rig import Rig, load_rig
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
    def backbones(self) -> dict[str, str]:
        """Backbones by the names of their folders: other weights never find what was made with these."""
        if not self.weights:
            return {"filterbank": "filterbank"}
        digest = hashlib.sha256(self.weights.encode()).hexdigest()[:8]
        return {"filterbank": "filterbank", f"{Path(self.weights).name}-{digest}": self.weights}

    @property
    def at_a_time(self) -> int:
        """Number of processes; one where they would share an accelerator."""
        return (self.processes or usable_cores()) if self.device == "cpu" else 1

    def described(self) -> dict[str, Any]:
        """The settings that must be the same for results in `out` to be used again; a backbone may be added."""
        size = {key: value for key, value in asdict(self.size).items() if key != "seeds"}
        return {"size": size, "logs": sorted(self.logs), "rig": self.rig, "split": self.split}


@dataclass(frozen=True)
class Drives:
    """Logs, the rig that reads them, and how they are split."""

    logs: tuple[str, ...]
    rig: Rig
    split: str


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
    backbones = {name: open_backbone(spec, device=settings.device) for name, spec in settings.backbones.items()}
    drives = _given(settings) if settings.logs else _simulated(settings)
    claim_folder(settings.out, settings.described())
    if not settings.logs:
        _drive(settings, drives)
    collected = {}
    for name, backbone in backbones.items():
        folder = settings.out / name
        run_steps(_data_steps(settings, drives, backbone, folder), record=partial(append_time, folder / "steps.jsonl"))
        collected[backbone.name] = _compared(settings, folder)
    page = write_evidence(collected, settings.out)
    logger.info(f"report to send back: {page}")
    return page


def _given(settings: EvidenceSettings) -> Drives:
    parse_split(settings.split)
    return Drives(tuple(str(log) for log in expanded(settings.logs)), load_rig(settings.rig), settings.split)


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


def _data_steps(settings: EvidenceSettings, drives: Drives, backbone: Backbone, folder: Path) -> list[list[Step]]:
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
        [Step(f"{backbone.name}: fit the PCA", 10.0 + 5 * count, pca.exists, fit)],
        [Step(f"{backbone.name}: extract {count} drive{'s' * (count > 1)}", 20.0 * count, extracted, extract)],
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
        model.label: [load_run(of.runs / model.folder(seed), device=of.device) for seed in range(of.size.seeds)]
        for model in models
        if model.label in MODELS
    }
    kept = folder / "controls"
    controls = run_controls(data.dataset, runs, stride=of.size.stride, scale=data.scale, kept=kept)
    return Collected(of, data, results, controls)
