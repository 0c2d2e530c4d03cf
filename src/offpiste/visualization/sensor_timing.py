"""When each sensor sends, with its gaps, and the time between its messages."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

from offpiste.logs.sensor_log import SensorLog
from offpiste.report.figure import BLUE, GREEN, ORANGE, plain

LONG = 3.0
"""An interval of so many usual ones is a gap."""


def stamps_of(log: SensorLog) -> dict[str, Float[np.ndarray, " _"]]:
    """Sorted times of poses, cameras and LiDARs, after the first pose [s]."""
    first = log.poses.span[0]
    result = {"poses": log.poses.position.time, **{name: log.stamps(name) for name in (*log.cameras, *log.lidars)}}
    return {name: np.sort(time) - first for name, time in result.items()}


def gaps(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " _"]:
    """Which of the intervals between messages [n - 1] are gaps: longer than three usual ones."""
    steps = np.diff(time)
    return steps > LONG * np.median(steps) if len(steps) else np.zeros(0, bool)


def draw_sensors(stamps: Mapping[str, Float[np.ndarray, " _"]], stretch: tuple[float, float]) -> Figure:
    """Above: when each sensor speaks. Below: the time between its messages.

    Args:
        stamps: of each sensor, sorted [s].
        stretch: the viewed part of the log, marked; its end may be infinite [s].
    """
    figure = Figure(figsize=(12, 2.6 + 0.34 * len(stamps) + 1.6), dpi=120, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(0.5 + 0.34 * len(stamps), 2.6))
    plain(above, "when each sensor sends; orange: gaps of more than three usual intervals")
    plain(below, "time between messages")
    for line, (name, time) in enumerate(stamps.items()):
        steps, gap = np.diff(time), gaps(time)
        colour = GREEN if name == "poses" else BLUE
        begins, ends = time[:-1][~gap], time[1:][~gap]
        above.hlines(np.full(len(begins), line), begins, ends, color=colour, linewidth=7)
        above.hlines(np.full(int(gap.sum()), line), time[:-1][gap], time[1:][gap], color=ORANGE, linewidth=3)
        below.plot(time[1:], steps, ".", markersize=3, label=_described(name, time), alpha=0.6)
    last = max((float(time[-1]) for time in stamps.values() if len(time)), default=1.0)
    for axes in (above, below):
        axes.axvspan(stretch[0], min(stretch[1], last), color="#0072b2", alpha=0.06)
    above.set_yticks(range(len(stamps)), list(stamps))
    above.set_ylim(len(stamps) - 0.5, -0.5)
    below.set(xlabel="after the first pose [s]", ylabel="[s]", yscale="log")
    below.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    below.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    below.yaxis.set_minor_locator(NullLocator())
    below.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _described(name: str, time: Float[np.ndarray, " n"]) -> str:
    if len(time) < 2:
        return f"{name}: {len(time)} messages"
    count = int(gaps(time).sum())
    return f"{name}: {len(time)}, {1 / np.median(np.diff(time)):.1f} Hz" + (f", {count} gaps" if count else "")
