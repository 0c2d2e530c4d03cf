"""What an evaluation's report says first: each model's error in a card, and in a sentence how it compares."""

from collections.abc import Sequence

import numpy as np

from offpiste.dynamics.models import is_baseline
from offpiste.evaluation.box_plots import colour_of
from offpiste.evaluation.errors import HORIZONS
from offpiste.evaluation.intervals import Levels, PairedDifference
from offpiste.evaluation.metrics import Headline, Metrics, ResultRow, pooled_rows, reading_label
from offpiste.report.page import Card
from offpiste.report.text_table import interval, number

MOST = 4
"""Differences to other models that stand at the top."""


def headline_texts(metrics: Metrics) -> list[str]:
    """The main number of the model that was named first, and its differences to other trained ones."""
    deciding = deciding_headlines(metrics.headlines)
    if not deciding:
        return []
    differences = _differences(metrics, deciding[0])
    more = [f"{len(differences) - MOST} more are below."] if len(differences) > MOST else []
    return [headline_text(deciding[0]), *differences[:MOST], *more]


def headline_text(headline: Headline) -> str:
    """A sentence with the main number."""
    text = f"{headline.model}: {number(headline.distance_error_m)} m mean distance error after 5 s"
    return f"{', '.join(filter(None, (text, _comparison(headline))))} ({', '.join(_conditions(headline))})"


def result_cards(metrics: Metrics) -> list[Card]:
    """A card for each trained model, and one for the model that they are compared with."""
    deciding = deciding_headlines(metrics.headlines)
    cards = [_card(headline) for headline in deciding]
    for row in pooled_rows(metrics.results):
        if deciding and (row.label, row.start) == (deciding[0].other, deciding[0].start) and _last(row):
            value = f"{number(row.distance_error_m.mean)} m"
            about = "mean distance error after 5 s"
            cards.append(Card(row.reading_label, value, about, note="without training", colour=colour_of(row.label)))
    return cards


def deciding_headlines(headlines: Sequence[Headline]) -> list[Headline]:
    """One headline per model: from the first start, with the terrain lookup that decides."""
    first = [headline for headline in headlines if headline.start == headlines[0].start]
    on_map = {headline.model for headline in first if headline.lookup == "map"}
    return [headline for headline in first if headline.lookup == "map" or headline.model not in on_map]


def _card(headline: Headline) -> Card:
    low, high = headline.ci95
    return Card(
        name=reading_label(headline.model, headline.lookup, headline.feature_set),
        value=f"{number(headline.distance_error_m)} m",
        about="mean distance error after 5 s",
        comparison=_comparison(headline),
        tone="better" if high < 0 else "worse" if low > 0 else "",
        note=", ".join(_conditions(headline)),
        colour=colour_of(headline.model),
    )


def _comparison(headline: Headline) -> str:
    """The error relative to that of the other model; empty where there is no finite one."""
    if not np.isfinite(headline.relative):
        return ""
    sign, side = (-1, "below") if headline.relative <= 0 else (1, "above")
    low, high = sorted(100 * sign * bound for bound in headline.ci95)
    bounds = f" {interval((low, high), 0)}" if np.isfinite(low) else ""
    return f"{100 * abs(headline.relative):.0f} %{bounds} {side} {headline.other}"


def _conditions(headline: Headline) -> list[str]:
    conditions = [f"{headline.start} start"]
    conditions += [f"{headline.lookup} lookup"] if headline.lookup else []
    return conditions + ([f"mean of {headline.runs} runs"] if headline.runs > 1 else [])


def _differences(metrics: Metrics, headline: Headline) -> list[str]:
    """A sentence for each other trained model."""
    case = (headline.model, headline.start, headline.lookup, headline.feature_set)
    rows = [row for row in pooled_rows(metrics.results) if _last(row)]
    trained = {row.label for row in rows if not is_baseline(row.model)}
    return [
        _difference(headline.model, other, minus.distance_error_m, row.levels)
        for row in rows
        if (row.label, row.start, row.lookup, row.feature_set) == case
        for other, minus in row.minus.items()
        if other in trained
    ]


def _difference(model: str, other: str, difference: PairedDifference, levels: Levels) -> str:
    (low, high), mean = difference.ci95, difference.mean
    if not np.isfinite(mean):
        return f"{model} and {other} are not compared: predictions failed, see below."
    if not np.isfinite(low):
        return f"{model} minus {other}: {number(mean)} m {levels.caveat}"
    if low <= 0 <= high:
        return f"No difference between {model} and {other} is shown: {number(mean)} m {interval(difference.ci95)}."
    size, bounds = abs(mean), sorted((abs(low), abs(high)))
    side = "less" if mean < 0 else "more"
    return f"{model} errs {number(size)} m {interval((bounds[0], bounds[1]))} {side} than {other}."


def _last(row: ResultRow) -> bool:
    return row.horizon_s == HORIZONS[-1]
