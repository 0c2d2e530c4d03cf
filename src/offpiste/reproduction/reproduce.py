"""`offpiste reproduce`: drives, features, models and judgement of a figure of the paper, in one resumable command."""

import logging
from functools import partial
from itertools import chain
from pathlib import Path

from offpiste.reproduction.data import data_pieces, expected_features, open_checked
from offpiste.reproduction.pieces import Piece, append_time, claim_folder, run_pieces
from offpiste.reproduction.report import write_figure
from offpiste.reproduction.results import gather
from offpiste.reproduction.runs import Driven, Work, driven_in, mapped, model_stages, readings
from offpiste.reproduction.settings import Reproduction, members
from offpiste.training.run import check_device

logger = logging.getLogger(__name__)

REPORT_COST = 30.0


def reproduce(asked: Reproduction) -> Path:
    """Make a figure in `asked.out`; whatever is there already from the same settings is used again.

    Returns:
        report.html.

    Raises:
        RunError: the folder was begun with other settings.
        OffpisteError: as the stages do.
    """
    check_device(asked.device)
    if asked.dataset is not None:
        open_checked(asked)
    data = data_pieces(asked)
    planned = _plan(asked, expected_features(asked), data)
    claim_folder(asked.out, asked.described())
    record = partial(append_time, asked.times)
    run_pieces([[piece] for piece in data], later=planned, record=record)
    work = Work(asked, open_checked(asked))
    chosen = members(asked.figure, len(work.dataset.features))
    found_ways = readings(asked.figure, mapped=mapped(work.dataset))
    stages = model_stages(asked, chosen, found_ways, driven_in(work.dataset))
    said: list[str] = []

    def report() -> None:
        claims = write_figure(asked, work, gather(asked, chosen, found_ways))
        said.extend(f"{claim}: {here} (paper: {paper}; {same})" for claim, paper, here, same in claims.lines)

    stages.append([Piece("report", REPORT_COST, lambda: False, report)])
    run_pieces(stages, before=len(data), processes=asked.at_a_time, record=record)
    for line in said:
        logger.info(line)
    page = asked.out / asked.figure / "report.html"
    logger.info(f"report: {page}")
    return page


def _plan(asked: Reproduction, stored: int, data: list[Piece]) -> list[Piece]:
    """What comes after the dataset, as far as it can be told before."""
    driven = Driven(*asked.size.seconds) if data else driven_in(open_checked(asked))
    chosen = members(asked.figure, stored)
    stages = model_stages(asked, chosen, readings(asked.figure, mapped=True), driven)
    return [*chain.from_iterable(stages), Piece("report", REPORT_COST, lambda: False, lambda: None)]
