"""Model cards: training data, accuracy and limits of use."""

from functools import partial
from pathlib import Path

import msgspec

from offpiste.core.errors import RunError
from offpiste.core.files import write_text
from offpiste.core.limits import parsed, read_small
from offpiste.evaluation.intervals import Levels, PairedDifference, percent
from offpiste.report.text_table import TextTable, interval, number

CARD, PAGE = "card.json", "card.md"
"""Files in the run's folder, for programs and readers."""


class GroupFigures(msgspec.Struct, frozen=True):
    """Mean distance error after 5 s on a group of windows, on the map at predicted places.

    Attributes:
        group: for example "all", "5 to 7 m/s" or "gravel".
        windows: number of windows.
        levels: numbers of drives, blocks and seeds behind the intervals.
        against_b: difference relative to the shipped `b` on the same windows; -0.1 is 10 % less.
    """

    group: str
    windows: int
    levels: Levels
    error_m: PairedDifference
    against_b: PairedDifference | None = None


class CourseFigures(msgspec.Struct, frozen=True):
    """Driving cost of a planner with the model on the proving ground's courses.

    Attributes:
        courses: number of courses, each in its own unseen world.
        against_b: difference of the driving cost relative to that of the shipped `b` on the same courses.
        commit, date: commits of the code, and date of the last drive.
    """

    courses: int
    against_b: PairedDifference
    commit: str
    date: str


class ModelCard(msgspec.Struct, frozen=True):
    """Card of a trained model.

    Attributes:
        lookup: map read at predicted places.
        seed: of this run, which has the smallest validation loss among `seeds`.
        commit, date: commit of the code that trained it, and date of the card.
        figures: of this run, by group.
        over_seeds: of the runs of all seeds, on all windows.
        not_for: excluded uses.
        warnings: of `inspect` on the training logs.
        driving: on courses, if measured.
    """

    name: str
    about: str
    trained_on: str
    evaluated_on: str
    lookup: str
    seed: int
    seeds: tuple[int, ...]
    commit: str
    date: str
    figures: tuple[GroupFigures, ...]
    over_seeds: GroupFigures
    not_for: tuple[str, ...]
    licence: str = "Apache-2.0"
    warnings: tuple[str, ...] = ()
    driving: CourseFigures | None = None


def load_card(folder: Path) -> ModelCard:
    """Read the card in a run's folder.

    Raises:
        RunError: it is missing or damaged.
    """
    path = folder / CARD
    try:
        return parsed(read_small(path), partial(msgspec.json.decode, type=ModelCard))
    except (OSError, ValueError, msgspec.MsgspecError) as error:
        raise RunError(f"is not a model card ({error})", where=path, how="install offpiste again") from error


def write_card(folder: Path, card: ModelCard) -> None:
    """Write card.json and card.md into a run's folder."""
    write_text(folder / CARD, msgspec.json.format(msgspec.json.encode(card), indent=1).decode() + "\n")
    write_text(folder / PAGE, card_page(card))


def card_page(card: ModelCard) -> str:
    """Return the card as Markdown."""
    facts = {
        "Trained on": card.trained_on,
        "Evaluated on": card.evaluated_on,
        "This run": f"seed {card.seed}, of the least validation loss among seeds {', '.join(map(str, card.seeds))}",
        "Code": f"commit {card.commit}",
        "Written": card.date,
        "Licence": card.licence,
        "Warnings of `inspect` on the logs": "; ".join(card.warnings),
    }
    lines = [f"# {card.name}", "", card.about, "", *(f"- **{name}**: {text}" for name, text in facts.items() if text)]
    lines += ["", figures_table(card).markdown()]
    if (found := card.driving) is not None:
        about = f"{driving_words(found)} Code: {found.commit}; {found.date}."
        lines += ["## How a planner drives with it", "", about, ""]
    lines += ["## What it must not be used for", "", *(f"- {use}" for use in card.not_for), ""]
    return "\n".join(lines)


def figures_table(card: ModelCard) -> TextTable:
    """Return the errors by group, those over all seeds first."""
    lines, caveats = [], dict[str, None]()
    for name, one in (("all, over all seeds", card.over_seeds), *((each.group, each) for each in card.figures)):
        error = f"{number(one.error_m.mean)} {interval(one.error_m.ci95)}"
        against = "" if one.against_b is None else percent(one.against_b, 0)
        lines.append((name, str(one.windows), one.levels.text(), error, against))
        caveats[one.levels.caveat] = None
    about = (
        f"Mean distance error after 5 s, from the causal start, on {card.lookup}, at predicted places; "
        "95 % intervals. Speed and kind of ground are those at a window's start."
    )
    names = ("windows that start", "number", "intervals over", "error [m]", "against `b`")
    return TextTable("How well it predicts", names, lines, " ".join(filter(None, (about, *caveats))))


def driving_words(driving: CourseFigures) -> str:
    """Describe the driving cost in a sentence."""
    low, high = driving.against_b.ci95
    shown = "" if low > 0 or high < 0 else ", so no difference is shown"
    courses = f"On {driving.courses} courses in unseen worlds"
    return f"{courses}, its driving cost differs from that of `b` by {percent(driving.against_b, 0)}{shown}."
