"""Models that learned nothing are named, and are not read as features that are worth nothing."""

from pathlib import Path

import pytest

from offpiste.evidence.trainings import has_learned, trainings_table
from offpiste.reproduction.settings import FigureModel, ReproductionSettings, Size
from offpiste.training.checkpoint import save_json


def kept(settings: ReproductionSettings, model: FigureModel, *epochs: int | None) -> None:
    for seed, epoch in enumerate(epochs):
        stage = {"epoch": epoch, "epochs": 12, "validation_loss": 0.25, "gained": 0.5}
        save_json(settings.runs / model.folder(seed) / "model.json", {"kept": {"model": stage}})


@pytest.fixture
def settings(tmp_path: Path) -> ReproductionSettings:
    return ReproductionSettings("fig4", Size("tiny", (1.0, 1.0, 1.0), seeds=2), tmp_path)


@pytest.mark.parametrize(("epochs", "learned"), [((0, 0), False), ((0, 3), True), ((12, 3), True), ((None, 0), True)])
def test_a_model_has_learned_unless_every_run_kept_its_start(
    settings: ReproductionSettings, epochs: tuple[int | None, ...], learned: bool
) -> None:
    model = FigureModel("dc", 4, 5)
    kept(settings, model, *epochs)
    assert has_learned(settings, model) == learned


def test_every_run_has_a_line(settings: ReproductionSettings) -> None:
    b, dc = FigureModel("b", 4, 5), FigureModel("dc", 4, 5)
    kept(settings, b, 7, 12)
    kept(settings, dc, 0, None)
    assert [line[:3] + line[4:] for line in trainings_table(settings, [b, dc]).lines] == [
        ("b", "0", "7 of 12", ""),
        ("b", "1", "12 of 12", "the last epoch: it may not have converged"),
        ("dc", "0", "0 of 12", "equals its start: no epoch was better"),
        ("dc", "1", "–", "not noted"),
    ]
