"""Run tutorials and write what they print and draw into their pages, e.g. after models that ship were replaced.

PYTHONPATH=src:tests python -m documentation.record docs/tutorials/predict.md
"""

import os
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from documentation.pages import run_page


def record(page: Path) -> None:
    """Replace outputs that differ, but for those with `…`, and the pictures that the page saves under its names."""
    text = page.read_text("utf-8")
    with TemporaryDirectory() as folder:
        work = Path(folder) / "work"
        work.mkdir()
        os.chdir(work)
        for step, printed in run_page(page, Path(folder)):
            if step.shown is not None and "…" not in step.shown and step.shown != printed:
                text = text.replace(f"```text\n{step.shown}```", f"```text\n{printed}```")
        for picture in work.glob("*.png"):
            if f"({picture.name})" in text:
                shutil.copy(picture, page.parent)
    page.write_text(text, "utf-8")


if __name__ == "__main__":
    os.environ["MPLBACKEND"] = "Agg"
    for name in [Path(argument).resolve() for argument in sys.argv[1:]]:
        record(name)
