"""`python -m tests.fuzz` in the checkout: commands with bad input, and a table of verdicts."""

import argparse
import contextlib
import io
import os
import platform
import shutil
import sys
import tempfile
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

from offpiste.cli.entry import LIBRARIES

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ |= LIBRARIES

import torch  # noqa: E402

from offpiste.core import progress  # noqa: E402
from tests.fuzz.cases import GOOD, Case, run_case  # noqa: E402
from tests.fuzz.corpus import make_corpus, run_command  # noqa: E402

progress.EVERY = float("inf")


def main() -> None:
    """Run the cases and print the table of verdicts."""
    options = _parsed()
    numbers = options.case or range(options.cases)
    cases = []
    with tempfile.TemporaryDirectory(prefix="offpiste-fuzz-") as folder, ExitStack() as opened:
        work, keep = Path(folder), options.out.with_suffix("") if options.out else Path("fuzz-cases")
        out = opened.enter_context(options.out.open("a", encoding="utf-8")) if options.out else None
        corpus = make_corpus(work / "corpus", Path(options.data) if options.data else None)
        _warm_up(work, corpus)
        for number in progress.track(numbers, "cases"):
            case = run_case(number, options.seed, corpus, work / "case")
            cases.append(case)
            if out:
                print(case.as_line(), file=out, flush=True)
            if case.verdict not in GOOD or options.case:
                print(case.as_line(), flush=True)
                shutil.rmtree(keep / f"case-{number}", ignore_errors=True)
                shutil.copytree(work / "case", keep / f"case-{number}")
                print(f"files: {keep / f'case-{number}'}", flush=True)
    print(table(cases))
    print(f"seed {options.seed}, {len(cases)} cases, {platform.machine()}, Python {platform.python_version()}")
    sys.exit(any(case.verdict not in GOOD for case in cases))


def _parsed() -> argparse.Namespace:
    beside = Path(__file__).parents[3] / "shared" / "data"
    recorded = os.environ.get("OFFPISTE_DATA") or (str(beside) if beside.is_dir() else "")
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=2000, help="number of cases")
    parser.add_argument("--seed", type=int, default=0, help="seed of all cases")
    parser.add_argument("--out", type=Path, help="JSON lines to append to; files of bad cases go into a folder beside")
    parser.add_argument("--case", type=int, nargs="+", help="run only these cases, and keep their files")
    parser.add_argument("--data", default=recorded, help="recorded drives, parts of which are inputs; '' for none")
    return parser.parse_args()


def _warm_up(folder: Path, corpus: list) -> None:
    """Import everything before forking."""
    torch.set_num_threads(1)
    seen: set[tuple[str, str]] = set()
    with contextlib.redirect_stdout(io.StringIO()):
        for number, sound in enumerate(corpus):
            command = sound.commands[0]
            if (sound.kind, command.split()[0]) in seen or sound.kind == "world":
                continue
            seen.add((sound.kind, command.split()[0]))
            out = folder / f"warm-{number}"
            out.mkdir()
            given = sound.files / sound.input if sound.input else sound.files
            with contextlib.suppress(SystemExit):
                run_command(command, input=given, out=out)


def table(cases: list[Case]) -> str:
    """Return the verdicts by kind of input, and the largest time and memory."""
    rows = []
    for kind in [*sorted({case.kind for case in cases}), "all"]:
        mine = [case for case in cases if kind in (case.kind, "all")]
        count = ", ".join(f"{number} {verdict}" for verdict, number in Counter(c.verdict for c in mine).most_common())
        rows.append(f"{kind:<12}{max(c.seconds for c in mine):>7.1f} s{max(c.memory for c in mine):>7} MB   {count}")
    return "\n".join(rows)


if __name__ == "__main__":
    main()
