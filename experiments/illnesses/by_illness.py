"""What `inspect` finds, an illness a row, over several runs: `python -m experiments.illnesses.by_illness FILE...`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments.command import run
from experiments.illnesses.results import read
from experiments.illnesses.score import Score
from experiments.illnesses.table import Row, costs


@dataclass(frozen=True)
class ByIllness:
    """Print a table of all illnesses, from single illnesses and from several at once."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE...")]
    """Files `scores.jsonl` of `python -m experiments.illnesses`."""

    def run(self) -> str:
        """The table as Markdown."""
        scores = [score for file in self.files for score in read(file, Score).values()]
        rows = [Row(score, ill) for score in scores for ill in score.illnesses]
        names = sorted({(row.ill.kind, row.ill.name) for row in rows})
        return "\n".join(
            [
                "| illness | strengths | logs | found | a note | at 5 % and more: found | in its own convention |"
                " right first cure |",
                "|---|---|---|---|---|---|---|---|",
                *(_line([row for row in rows if (row.ill.kind, row.ill.name) == name]) for name in names),
            ]
        )


def _line(rows: Sequence[Row]) -> str:
    alone = [row for row in rows if len(row.score.illnesses) == 1]
    found = sum(row.ill.found for row in rows)
    noted = sum(row.ill.noted and not row.ill.found for row in rows)
    of_costly, of_own = (_found([row for row in alone if costs(row.score, own=own)]) for own in (False, True))
    tried = [row for row in alone if row.ill.first_cure and row.ill.curable]
    cured = f"{sum(row.ill.first_cure == 'right' for row in tried)}/{len(tried)}" if tried else ""
    strengths = ", ".join(f"{value:g}" for value in sorted({row.ill.strength for row in rows}))
    name = rows[0].ill.name
    return (
        f"| {name} | {strengths} | {len(rows)} | {found}/{len(rows)} | {noted or ''} | {of_costly} | {of_own} |"
        f" {cured} |"
    )


def _found(rows: Sequence[Row]) -> str:
    return f"{sum(row.ill.found for row in rows)}/{len(rows)}" if rows else ""


if __name__ == "__main__":
    run(ByIllness)
