"""What the paper says of its figures, beside what was found: nothing is rounded in favour of either."""

from collections.abc import Iterator, Sequence

import numpy as np

from offpiste.evaluation.metrics import PairedDifference
from offpiste.evaluation.table import interval
from offpiste.evaluation.ways import Way
from offpiste.experiments.reproduce.models import compression_sizes, feature_numbers
from offpiste.experiments.reproduce.results import Findings
from offpiste.viewing.cover_table import TextTable

HINDSIGHT: Way = ("recorded", "hindsight")
MAP: Way = ("map", None)


def percent(difference: PairedDifference) -> str:
    """A relative difference with its interval."""
    if not np.isfinite(difference.mean):
        return "–"
    low, high = difference.ci95
    return f"{100 * difference.mean:+.1f} % {interval((100 * low, 100 * high), 1)}"


def verdict(difference: PairedDifference, limit: float = 0.0) -> str:
    """Whether errors are below `limit` (-0.1: by 10 % and more), as the mean says and as its interval does."""
    if not np.isfinite(difference.mean):
        return "–"
    reached = "yes" if difference.mean <= limit else "no"
    high = difference.ci95[1]
    sure = np.isfinite(high) and (high <= limit if reached == "yes" else difference.ci95[0] > limit)
    return reached if sure else f"{reached}, not certain"


def fig3_claims(found: Findings, stored: int) -> TextTable:
    """Hindsight: what features are worth, and that neither n nor their number matters much."""
    by_label = {member.label: member for member in found.members}
    lines: list[tuple[str, ...]] = []
    for quantity, name, limit in (("loss", "summed loss", -0.10), ("vx_error_mps", "v_x error at 5 s", -0.08)):
        for way in _present(found, (HINDSIGHT, MAP)):
            mine = found.against(by_label["cf"], way).relative[quantity]
            paper = f"{100 * limit:.0f} %" if way == HINDSIGHT else f"{100 * limit:.0f} % (recorded)"
            lines.append((f"cf against b, mean {name}, {_said(way)}", paper, percent(mine), verdict(mine, limit)))
    for way in _present(found, (HINDSIGHT, MAP)):
        df, cf = (found.against(by_label[name], way).relative["distance_error_m"] for name in ("df", "cf"))
        apart = df.mean - cf.mean
        lines.append(
            (
                f"df at or slightly below cf, distance error, {_said(way)}",
                "df slightly below",
                f"df {100 * df.mean:+.1f} %, cf {100 * cf.mean:+.1f} % of b",
                "yes" if apart <= 0 else "no",
            )
        )
    for name, swept in (("n", compression_sizes(stored)), ("PCA features", feature_numbers(stored))):
        gains = {n: found.against(member, HINDSIGHT).relative["distance_error_m"].mean for n, member in swept.items()}
        said = ", ".join(f"{n}: {100 * gain:+.1f} %" for n, gain in gains.items())
        below = all(gain < 0 for gain in gains.values())
        lines.append((f"robust to {name}, distance error against b", "all below b", said, "yes" if below else "no"))
    return _table(lines)


def fig4_claims(found: Findings) -> TextTable:
    """Distance: naive training fails far away, `dc` does not."""
    by_label = {member.label: member for member in found.members}

    def gain(label: str, name: str) -> PairedDifference:
        return found.against(by_label[label], ("recorded", name)).relative["distance_error_m"]

    lines: list[tuple[str, ...]] = []
    for label in ("df", "cf"):
        far = {name: gain(label, name) for name in ("20", "30", "40")}
        behind = [name for name, value in far.items() if value.mean > 0]
        said = ", ".join(f"{name} m: {100 * value.mean:+.1f} %" for name, value in far.items())
        lines.append((f"{label} falls behind b far away", "behind", said, "yes" if behind else "no"))
    ahead = [gain("df", name).mean - gain("cf", name).mean for name in ("10", "20", "30", "40")]
    said = f"df minus cf, mean over 10 to 40 m: {100 * float(np.mean(ahead)):+.1f} % of b"
    lines.append(("df is more sensitive than cf", "df worse", said, "yes" if np.mean(ahead) > 0 else "no"))
    for name in ("hindsight", "0", "10", "20", "30"):
        value = gain("dc", name)
        where = "in hindsight" if name == "hindsight" else f"at {name} m"
        lines.append((f"dc below b {where}", "below", percent(value), verdict(value)))
    for way in _present(found, (MAP,)):
        value = found.against(by_label["dc"], way).relative["distance_error_m"]
        lines.append((f"dc below b, {_said(way)} (decides)", "not in the paper", percent(value), verdict(value)))
    return _table(lines)


def sentences(found: Findings, label: str) -> list[str]:
    """The main numbers of a model, the way that decides first."""
    member = next(member for member in found.members if member.label == label)

    def sentence(way: Way) -> str:
        gains = found.against(member, way).relative
        numbers = f"distance error after 5 s {percent(gains['distance_error_m'])}, loss {percent(gains['loss'])}"
        return f"{label} against b, {_said(way)}: {numbers}"

    return [sentence(way) for way in _present(found, (MAP, HINDSIGHT))]


def _present(found: Findings, wanted: Sequence[Way]) -> Iterator[Way]:
    return (way for way in wanted if way in found.ways)


def _said(way: Way) -> str:
    return "map at predicted places" if way == MAP else "recorded lookup in hindsight"


def _table(lines: Sequence[tuple[str, ...]]) -> TextTable:
    about = (
        "Relative to b on the same windows, with 95 % intervals. The last column follows the mean; 'not certain' where "
        "its interval holds the limit as well."
    )
    return TextTable("What the paper says", ("claim", "paper", "here", "as in the paper"), tuple(lines), about)
