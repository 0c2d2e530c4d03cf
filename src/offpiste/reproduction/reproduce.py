"""Reproduction of a figure in resumable steps: drives, features, models, evaluation, report."""

import logging
from pathlib import Path

from offpiste.dataset.windows import Windows
from offpiste.reproduction.data import data_steps, driven_seconds, open_checked, stored_features
from offpiste.reproduction.report import write_figure
from offpiste.reproduction.results import MAP, read_results
from offpiste.reproduction.runs import PART, model_stages
from offpiste.reproduction.settings import ReproductionSettings, figure_models, figure_readings
from offpiste.reproduction.steps import Step, claim_folder, run_steps
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
    driven, readings = settings.size.seconds, figure_readings(settings.figure)
    if settings.dataset is not None:
        given = open_checked(settings)
        driven = driven_seconds(given)
        if not Windows(given, PART).maps.any:
            readings.remove(MAP)
    models = figure_models(settings.figure, stored_features(settings))
    making_data = data_steps(settings)
    claim_folder(settings.out, settings.described(), own=("settings.json", "pca.safetensors"))
    claims: list[str] = []

    def report() -> None:
        table = write_figure(settings, read_results(settings, models, readings))
        claims.extend(
            f"{claim}: {here} (the paper: {paper}; agrees: {same})" for claim, paper, here, same in table.lines
        )

    stages = [[step] for step in making_data] + model_stages(settings, models, readings, driven)
    run_steps([*stages, [Step("report", REPORT_COST, lambda: False, report)]], processes=settings.at_a_time)
    for line in claims:
        logger.info(line)
    page = settings.out / settings.figure / "report.html"
    logger.info(f"report: {page}")
    return page
