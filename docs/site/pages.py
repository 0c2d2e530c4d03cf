"""Hooks of MkDocs: pages that are made from the repository, and Markdown as GitHub reads it.

The README becomes the home page; the list of changes, the studies' README and the examples become pages; commands.md
gets the help of every command. Links that lead out of docs/ are followed to these pages.
"""

import ast
import os
import posixpath
import re
import subprocess
import sys
from pathlib import Path, PurePosixPath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "experiments/README.md": "experiments.md",
    "examples": "examples/index.md",
}
"""Pages of the site that are files of the repository outside of docs/."""

LINK = re.compile(r"(\]\()(?!\w+:|#|/)([^)#\s]+)(#[^)\s]*)?\)")
FENCE = re.compile(r"^\s*```")
BLOCK = re.compile(r"^(?:[-*] |\d+\. |\|)")
COMMAND_HELP = "<!-- help -->"
LOOK = "src/offpiste/report/look.css"
"""Colours and type of reports, which the site shares."""


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages that are made from files outside of docs/, and the look of reports."""
    files.append(File.generated(config, "site/look.css", abs_src_path=str(ROOT / LOOK)))
    for source, page in PAGES.items():
        if (ROOT / source).is_file():
            files.append(File.generated(config, page, content=(ROOT / source).read_text("utf-8")))
    examples = [path for path in sorted((ROOT / "examples").rglob("*")) if path.suffix in (".py", ".toml")]
    for path in examples:
        page = path.relative_to(ROOT).with_suffix(".md").as_posix()
        if page not in {file.src_uri for file in files}:
            files.append(File.generated(config, page, content=example_page(path)))
    files.append(File.generated(config, "examples/index.md", content=example_index(examples)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links within the site, and an empty line before lists and tables, which Python-Markdown needs."""
    if COMMAND_HELP in markdown:
        markdown = markdown.replace(COMMAND_HELP, command_help())
    here = page.file.src_uri
    sources = {target: source for source, target in PAGES.items()}
    folder = posixpath.dirname(sources.get(here, f"docs/{here}"))
    lines, in_code, previous = [], False, ""
    for line in markdown.splitlines():
        if FENCE.match(line):
            in_code = not in_code
        elif not in_code:
            if (found := BLOCK.match(line)) and previous.strip() and not starts_like(previous, found.group(0)):
                lines.append("")
            line = LINK.sub(
                lambda link: link.group(1) + in_site(link.group(2), folder, here) + (link.group(3) or "") + ")", line
            )
        lines.append(line)
        previous = line
    return "\n".join(lines) + "\n"


def starts_like(previous: str, mark: str) -> bool:
    """Whether a line belongs to the list or table that the line before it is part of."""
    return bool(BLOCK.match(previous)) or (previous.startswith(" ") and not mark.startswith("|"))


def in_site(link: str, folder: str, here: str) -> str:
    """A link as a page of the site needs it.

    Args:
        folder: of the file that has the link, in the repository.
        here: the page that the file becomes.
    """
    target = posixpath.normpath(posixpath.join(folder, link))
    if target in PAGES:
        page = PAGES[target]
    elif target.startswith("docs/"):
        page = target.removeprefix("docs/")
    elif target.startswith("examples/"):
        page = PurePosixPath(target).with_suffix(".md").as_posix()
    else:
        return link
    return posixpath.relpath(page, posixpath.dirname(here) or ".")


def example_page(path: Path) -> str:
    """An example as it is, below its first line."""
    code, name = path.read_text("utf-8"), path.relative_to(ROOT).as_posix()
    return f"# {path.stem}\n\n`{name}`: {first_line(path)}\n\n```{path.suffix[1:].replace('py', 'python')}\n{code}```\n"


def example_index(paths: list[Path]) -> str:
    """List of all examples."""
    lines = [
        f"| [{path.relative_to(ROOT / 'examples').as_posix()}]"
        f"({path.relative_to(ROOT / 'examples').with_suffix('.md').as_posix()}) | {first_line(path)} |"
        for path in paths
        if path.suffix == ".py"
    ]
    about = (
        "Complete scripts, each run by a test. Those of `extending/` add a part from outside of the package;"
        " [Extending](../extending.md) explains them. The [tutorials](../tutorials/predict.md) take smaller steps."
    )
    return "\n".join(["# Examples", "", about, "", "| script | what it does |", "|---|---|", *lines, ""])


def first_line(path: Path) -> str:
    """What an example says of itself."""
    if path.suffix == ".py":
        return (ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "").split("\n")[0].rstrip(".:") + "."
    return path.read_text("utf-8").split("\n")[0].lstrip("# ")


def command_help() -> str:
    """The help of every command, as a terminal of 100 columns shows it."""
    from offpiste.cli.entry import commands_in_order

    environment = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}
    parts = []
    for name in commands_in_order():
        command = [sys.executable, "-m", "offpiste", name, "--help"]
        text = subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout
        parts += [f"## {name}", "", "```console", text.rstrip(), "```", ""]
    return "\n".join(parts)
