"""Reproduction of a figure in resumable steps: drives, features, models, evaluation, report."""

import logging
from functools import partial
from itertools import chain
from pathlib import Path

from offpiste.reproduction.data import data_steps, expected_features, open_checked
from offpiste.reproduction.report import write_figure
from offpiste.reproduction.results import gather
from offpiste.reproduction.runs import DrivenTime, EvaluationData, driven_time, figure_readings, mapped, model_stages
from offpiste.reproduction.settings import ReproductionSettings, figure_models
from offpiste.reproduction.steps import Step, append_time, claim_folder, run_steps
from offpiste.training.run import check_device

logger = logging.getLogger(__name__)

REPORT_COST = 30.0


def reproduce(settings: ReproductionSettings) -> Path:
    """Make a figure in `settings.out`, reusing results of the same settings.

    Returns:
        Path of report.html.

    Raises:
        RunError: the folder was begun with other settings.
        OffpisteError: a stage failed.
    """
    check_device(settings.device)
    if settings.dataset is not None:
        open_checked(settings)
    making_data = data_steps(settings)
    planned = _plan(settings, expected_features(settings), making_data)
    claim_folder(settings.out, settings.described(), own=("settings.json", "pca.safetensors"))
    record = partial(append_time, settings.times)
    run_steps([[step] for step in making_data], later=planned, record=record)
    data = EvaluationData(settings, open_checked(settings))
    chosen = figure_models(settings.figure, len(data.dataset.features))
    chosen_readings = figure_readings(settings.figure, mapped=mapped(data.dataset))
    stages = model_stages(settings, chosen, chosen_readings, driven_time(data.dataset))
    lines: list[str] = []

    def report() -> None:
        claims = write_figure(settings, data, gather(settings, chosen, chosen_readings))
        lines.extend(
            f"{claim}: {here} (the paper: {paper}; agrees: {same})" for claim, paper, here, same in claims.lines
        )

    stages.append([Step("report", REPORT_COST, lambda: False, report)])
    run_steps(stages, before=len(making_data), processes=settings.at_a_time, record=record)
    for line in lines:
        logger.info(line)
    page = settings.out / settings.figure / "report.html"
    logger.info(f"report: {page}")
    return page


def _plan(settings: ReproductionSettings, stored: int, making_data: list[Step]) -> list[Step]:
    """Return the steps after the dataset, as estimated before it exists."""
    driven = DrivenTime(*settings.size.seconds) if making_data else driven_time(open_checked(settings))
    chosen = figure_models(settings.figure, stored)
    stages = model_stages(settings, chosen, figure_readings(settings.figure, mapped=True), driven)
    return [*chain.from_iterable(stages), Step("report", REPORT_COST, lambda: False, lambda: None)]
