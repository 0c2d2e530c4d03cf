"""report.html: one page that needs nothing but itself."""

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from string import Template

import numpy as np

from offpiste.dynamics.models import is_baseline
from offpiste.evaluation.errors import COMPONENTS, HORIZONS
from offpiste.evaluation.intervals import PairedDifference
from offpiste.evaluation.results import Headline, Metrics, Minus, ResultRow, pooled_rows, run_rows
from offpiste.evaluation.tables import REFERENCE, by_reading, interval, number

_NAMES = {
    "distance_error_m": "distance [m]",
    "yaw_error_rad": "yaw [rad]",
    "vx_error_mps": "vx [m/s]",
    "vy_error_mps": "vy [m/s]",
    "yaw_rate_error_radps": "yaw rate [rad/s]",
    "loss": "loss",
}

_CAPTIONS = {
    "box": "Distance error after 5 s. Boxes: quartiles; whiskers: last value within 1.5 IQR, given by the values with "
    "arrows; green: median; orange: mean. Values beyond the whiskers are not drawn.",
    "growth": "Mean distance error against the horizon; bands: 95 % intervals of the mean.",
    "distribution": "Share of windows whose distance error after 5 s stays below a value.",
    "speed": "Mean distance error after 5 s by the speed at the start; every bin holds as many windows.",
    "worst": "The windows of largest distance error after 5 s, no two of which overlap. The vehicle starts at the "
    "triangle and looks up; dots are the places after 5 s. A model with several runs has a line for each.",
}


def render_html(metrics: Metrics, pictures: Mapping[str, bytes]) -> str:
    """The page.

    Args:
        pictures: PNG files by name, of those in the page's captions; others are left out.
    """
    page = Template(resources.files("offpiste.evaluation").joinpath("report.html").read_text("utf-8"))
    rows = pooled_rows(metrics.results)
    models = ", ".join(dict.fromkeys(headline.model for headline in metrics.headlines)) or "baselines"
    return page.substitute(
        title=_safe(f"{models} on {metrics.dataset.rstrip('/').rpartition('/')[2]}"),
        headline="".join(f"<p>{_safe(headline_text(headline))}</p>" for headline in _leading(metrics.headlines)),
        facts=_facts(metrics),
        horizons=_horizon_table(rows),
        components=_component_table(rows),
        distribution_table=_distribution_table(rows),
        differences=_difference_table(rows),
        runs=_run_section(run_rows(metrics.results)),
        notes=_notes(metrics),
        **{name: _picture(name, pictures.get(name)) for name in _CAPTIONS},
    )


def headline_text(headline: Headline) -> str:
    """One sentence with the main number."""
    readings = [f"{headline.start} start"]
    readings += [f"{headline.lookup} lookup"] if headline.lookup else []
    readings += [f"mean of {headline.runs} runs"] if headline.runs > 1 else []
    text = f"{headline.model}: {number(headline.distance_error_m)} m mean distance error after 5 s"
    if np.isfinite(headline.relative):
        sign, side = (-1, "below") if headline.relative <= 0 else (1, "above")
        low, high = sorted(100 * sign * bound for bound in headline.ci95)
        bounds = f" {interval((low, high), 0)}" if np.isfinite(low) else ""
        text += f", {100 * abs(headline.relative):.0f} %{bounds} {side} {headline.other}"
    return f"{text} ({', '.join(readings)})"


def _leading(headlines: Sequence[Headline]) -> list[Headline]:
    """One a model: from the first start, reading the ground in the way that decides."""
    first = [headline for headline in headlines if headline.start == headlines[0].start]
    on_map = {headline.model for headline in first if headline.lookup == "map"}
    return [headline for headline in first if headline.lookup == "map" or headline.model not in on_map]


def _facts(metrics: Metrics) -> str:
    windows, made = metrics.windows, metrics.made
    failed = sum(row.n_failed for row in metrics.results if row.horizon_s == HORIZONS[-1])
    facts = {
        "dataset": metrics.dataset,
        "split": f"{metrics.split}; judged on the {metrics.part} part",
        "windows": f"{windows.n} of 5 s from {windows.drives} drive(s), one every {windows.stride_s:g} s, "
        f"in {windows.blocks} blocks of {windows.block_s:g} s",
        "driving": f"median {number(windows.median_distance_m, 1)} m in 5 s, "
        f"{number(windows.median_speed_mps, 1)} m/s at the start",
        "seen before": f"{number(100 * windows.driven_in_training, 0)} % of the path lies within 5 m of training's",
        "date": made.date,
        "machine": made.machine,
        "command": made.command,
        "versions": ", ".join(f"{name} {version}" for name, version in made.versions.items()),
    }
    if failed:
        facts["failed"] = f"{failed} predictions are not finite; means over them are not either"
    return f"<dl>{''.join(f'<dt>{_safe(key)}</dt><dd>{_safe(value)}</dd>' for key, value in facts.items())}</dl>"


def _horizon_table(rows: Sequence[ResultRow]) -> str:
    """Ways as lines, starts side by side."""
    starts = list(dict.fromkeys(row.start for row in rows))
    mean = {(row.reading, row.start, row.horizon_s): number(row.distance_error_m.mean) for row in rows}
    groups = "".join(f'<th class="group" colspan="{len(HORIZONS)}">{_safe(start)} start [m]</th>' for start in starts)
    seconds = "".join(f"<th>{horizon} s</th>" for _ in starts for horizon in HORIZONS)
    lines = []
    for name in dict.fromkeys(name for name, _, _ in mean):
        cells = [
            f"<td{_first(horizon)}>{mean.get((name, start, float(horizon)), '')}</td>"
            for start in starts
            for horizon in HORIZONS
        ]
        lines.append(f'<tr><td class="name">{_safe(name)}</td>{"".join(cells)}</tr>')
    head = f'<tr><th class="name" rowspan="2">model</th>{groups}</tr><tr>{seconds}</tr>'
    return f'<div class="scroll"><table><thead>{head}</thead><tbody>{"".join(lines)}</tbody></table></div>'


def _component_table(rows: Sequence[ResultRow]) -> str:
    lines = [
        [
            _safe(row.reading),
            _safe(row.start),
            *(_with_interval(getattr(row, name).mean, getattr(row, name).ci95, 3) for name in _NAMES),
        ]
        for row in _at_the_end(rows)
    ]
    about = "Mean absolute errors with 95 % intervals; the loss is over all steps."
    return f'<p class="about">{about}</p>{_table(["model", "start", *_NAMES.values()], lines, left=2)}'


def _distribution_table(rows: Sequence[ResultRow]) -> str:
    lines = []
    for row in _at_the_end(rows):
        error = row.distance_error_m
        numbers = (error.mean, error.q1, error.median, error.q3, error.p90)
        windows = f"{row.n}" + (f" ({row.n_failed} failed)" if row.n_failed else "")
        lines.append([_safe(row.reading), _safe(row.start), *map(number, numbers), windows])
    names = ["model", "start", "mean [m]", "25 % [m]", "median [m]", "75 % [m]", "90 % [m]", "windows"]
    return _table(names, lines, left=2)


def _difference_table(rows: Sequence[ResultRow]) -> str:
    """Pairs as lines, each once; starts side by side."""
    found: dict[tuple[str, str], dict[str, Minus]] = {}
    learned = [row for row in _at_the_end(rows) if not is_baseline(row.model)]
    order = list(dict.fromkeys(row.label for row in learned))
    for row in learned:
        for other, minus in row.minus.items():
            if other not in order or order.index(other) > order.index(row.label):
                found.setdefault((row.reading, other), {})[row.start] = minus
    starts = list(dict.fromkeys(row.start for row in rows))
    lines = []
    for (name, other), by_start in found.items():
        cells = []
        for start in starts:
            minus = by_start[start]
            cells += [_difference(minus.distance_error_m), _difference(minus.loss)]
        lines.append([f"{_safe(name)} minus {_safe(other)}", *cells])
    names = [f"{start}: {what}" for start in starts for what in ("distance [m]", "loss")]
    about = "The same windows for both; negative: the first is better; bold: the 95 % interval does not hold 0."
    return f'<p class="about">{about}</p>{_table(["", *names], lines, left=1)}'


def _run_section(rows: Sequence[ResultRow]) -> str:
    """Each run by itself, where a model has several."""
    if not rows:
        return ""
    lines = []
    for row in _at_the_end(rows):
        against = row.minus.get(REFERENCE)
        lines.append(
            [
                _safe(row.reading),
                _safe(row.start),
                "" if row.seed is None else str(row.seed),
                "" if row.fold is None else str(row.fold),
                _with_interval(row.distance_error_m.mean, row.distance_error_m.ci95, 2),
                number(row.distance_error_m.median),
                number(row.loss.mean, 3),
                _difference(against.distance_error_m) if against else "",
                str(row.n),
            ]
        )
    names = [
        "model",
        "start",
        "seed",
        "fold",
        "distance [m]",
        "median [m]",
        "loss",
        f"minus {REFERENCE} [m]",
        "windows",
    ]
    return f"<h2>Each run after 5 s</h2>{_table(names, lines, left=2)}"


def _notes(metrics: Metrics) -> str:
    units = ", ".join(f"{name} {np.sqrt(scale):.3g}" for name, scale in metrics.loss.scale.items())
    weights = ", ".join(f"{name} {weight:g}" for name, weight in metrics.loss.weights.items())
    notes = (
        "Start: a causal start knows only what was known at the time; a smoothed one sees a little of the future, and "
        "is shown beside it for comparison. The causal one is what a planner has.",
        "Lookup: recorded reads the ground under the recorded future path, as in the paper, which also tells a model "
        "how far the vehicle went; map reads it at the predicted place, as a planner does, and decides. Models without "
        "a lookup do not read the ground.",
        f"Intervals are of the mean, bootstrapped over blocks: windows of one drive that start within "
        f"{metrics.windows.block_s:g} s of each other stay together, since overlapping windows tell the same thing. "
        "A dash: fewer than three blocks.",
        "A model with several runs: each window's error is the mean over seeds; folds judge different windows, which "
        "are put together. It is the mean of errors, not the error of a mean prediction.",
        f"The loss is the mean over all 250 steps of squared errors, each divided by the mean square error of "
        f"{REFERENCE} in training (roots: {units}), weighted ({weights}) and summed.",
        "A prediction that is not finite counts as infinitely wrong.",
    )
    return f"<ul>{''.join(f'<li>{_safe(note)}</li>' for note in notes)}</ul>"


def _picture(name: str, content: bytes | None) -> str:
    if content is None:
        return ""
    data = base64.b64encode(content).decode("ascii")
    caption = _safe(_CAPTIONS[name])
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'
    )


def _at_the_end(rows: Sequence[ResultRow]) -> list[ResultRow]:
    """Those of the last horizon."""
    return [group[-1] for group in by_reading(rows)]


def _table(names: Sequence[str], lines: Iterable[Sequence[str]], *, left: int) -> str:
    """A table of cells that are HTML already; the first `left` columns are names."""

    def cells(tag: str, values: Sequence[str]) -> str:
        kinds = (' class="name"' if i < left else "" for i in range(len(values)))
        return "".join(f"<{tag}{kind}>{value}</{tag}>" for kind, value in zip(kinds, values, strict=True))

    body = "".join(f"<tr>{cells('td', line)}</tr>" for line in lines)
    head = cells("th", [_safe(name) for name in names])
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _with_interval(mean: float, bounds: tuple[float, float], digits: int) -> str:
    return f'{number(mean, digits)} <span class="interval">{interval(bounds, digits)}</span>'


def _difference(difference: PairedDifference) -> str:
    low, high = difference.ci95
    text = _with_interval(difference.mean, difference.ci95, 3)
    return f"<strong>{text}</strong>" if low > 0 or high < 0 else text


def _first(horizon: int) -> str:
    return ' class="first"' if horizon == HORIZONS[0] else ""


def _safe(text: str) -> str:
    return html.escape(text, quote=True)


assert tuple(_NAMES)[:-1] == COMPONENTS
