"""`python -m tests.fuzz`, from the checkout, or with PYTHONPATH=.: many cases of bad input, and a table of verdicts."""

import argparse
import contextlib
import io
import json
import os
import platform
import sys
import tempfile
from collections import Counter
from pathlib import Path

from offpiste.cli.entry import LIBRARIES

for _threads in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ |= LIBRARIES  # as the command line does before libraries are imported

import torch  # noqa: E402

from offpiste.core import progress  # noqa: E402
from tests.fuzz.cases import GOOD, Case, run_case  # noqa: E402
from tests.fuzz.corpus import make_corpus, run_command  # noqa: E402

progress.EVERY = float("inf")  # lines of progress depend on the machine
VERDICTS = (*GOOD, "wrong message", "traceback", "hang", "memory", "killed")


def main() -> None:
    """Parse the arguments, run the cases that are not in the file yet, print the table."""
    options = _parsed()
    data = Path(options.data) if options.data else None
    done = _read(options.out, options.seed) if options.out and not options.case else {}
    numbers = options.case or [n for n in range(options.first, options.first + options.cases) if n not in done]
    with tempfile.TemporaryDirectory(prefix="offpiste-fuzz-") as folder:
        work = Path(folder)
        corpus = make_corpus(work / "corpus", data)
        _warm_up(work, corpus)
        keep = Path(options.keep or (options.out.with_suffix("") if options.out else "fuzz-cases"))
        for number in progress.track(numbers, "cases"):
            case = run_case(number, options.seed, corpus, work / "case")
            done[number] = case
            if options.out and not options.case:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(case.as_line() + "\n")
            if case.verdict not in GOOD or options.case:
                print(case.as_line(), flush=True)
                _keep(work / "case", keep / f"case-{number}")
    print(table(list(done.values())))
    print(f"seed {options.seed}, {len(done)} cases, {platform.machine()}, Python {platform.python_version()}")
    sys.exit(any(case.verdict not in GOOD for case in done.values()))


def _parsed() -> argparse.Namespace:
    beside = Path(__file__).parents[3] / "shared" / "data"
    recorded = os.environ.get("OFFPISTE_DATA") or (str(beside) if beside.is_dir() else "")
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=2000, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first: several processes share the work")
    parser.add_argument("--seed", type=int, default=0, help="with the number of a case it decides on its input")
    parser.add_argument("--out", type=Path, help="JSON lines; cases that it holds are not run again")
    parser.add_argument("--case", type=int, nargs="+", help="run only these, and keep their files")
    parser.add_argument("--keep", type=Path, help="folder for the files of bad cases; by default named as --out")
    parser.add_argument("--data", default=recorded, help="recorded drives, of which parts are inputs too; '' for none")
    return parser.parse_args()


def _read(path: Path, seed: int) -> dict[int, Case]:
    """Cases of an earlier, interrupted run."""
    lines = path.read_text("utf-8").splitlines() if path.is_file() else []
    cases = (Case(**json.loads(line)) for line in lines if line.endswith("}"))
    return {case.case: case for case in cases if case.seed == seed}


def _warm_up(folder: Path, corpus: list) -> None:
    """Import everything and load the kernels, once for all forks."""
    torch.set_num_threads(1)
    seen: set[tuple[str, str]] = set()
    with contextlib.redirect_stdout(io.StringIO()):
        for number, sound in enumerate(corpus):
            command = sound.commands[0]
            if (sound.kind, command.split()[0]) in seen or sound.kind in ("world", "image list"):
                continue
            seen.add((sound.kind, command.split()[0]))
            out = folder / f"warm-{number}"
            out.mkdir()
            given = sound.files / sound.input if sound.input else sound.files
            with contextlib.suppress(SystemExit):
                run_command(command, input=given, out=out)


def _keep(case: Path, to: Path) -> None:
    import shutil

    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(case, to)
    print(f"files: {to}", flush=True)


def table(cases: list[Case]) -> str:
    """Verdicts by kind of input, and the largest time and memory."""
    rows = [f"{'input':<12}{'cases':>7}" + "".join(f"{v:>15}" for v in VERDICTS) + f"{'s':>7}{'MB':>7}{'warned':>8}"]
    kinds = sorted({case.kind for case in cases})
    for kind in [*kinds, "all"]:
        mine = [case for case in cases if kind in (case.kind, "all")]
        count = Counter(case.verdict for case in mine)
        longest, largest = max(c.seconds for c in mine), max(c.memory for c in mine)
        warned = sum(c.warnings > 0 for c in mine)
        verdicts = "".join(f"{count[v]:>15}" for v in VERDICTS)
        rows.append(f"{kind:<12}{len(mine):>7}{verdicts}{longest:>7.1f}{largest:>7}{warned:>8}")
    return "\n".join(rows)


if __name__ == "__main__":
    main()
