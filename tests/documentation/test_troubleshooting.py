"""Messages quoted in docs/troubleshooting.md occur in the source."""

import ast
import re
from functools import cache
from pathlib import Path

from offpiste.inspection.findings import MESSAGES

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
QUOTED = [message for line in re.findall(r"^#### (.*)$", PAGE, re.MULTILINE) for message in line.split("`")[1::2]]


def text_of(node: ast.expr) -> str:
    """A string of the source, with `…` for what is filled in; "" for other expressions."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return ""


@cache
def strings_of_the_source() -> frozenset[str]:
    """All strings but docstrings."""
    found: set[str] = set()
    for file in (ROOT / "src" / "offpiste").rglob("*.py"):
        tree = ast.parse(file.read_text("utf-8"))
        stated = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        found |= {text_of(node) for node in ast.walk(tree) if isinstance(node, ast.expr) and id(node) not in stated}
    texts = (str(text) for message in MESSAGES.values() for text in message.values())
    return frozenset(found | {re.sub("{[^}]*}", "…", text) for text in texts})


def occurs(message: str) -> bool:
    """Return whether a message is, or is part of, a string of the source; `…` stands for inserted text."""
    pattern = re.compile(r"(?:.*…)?" + re.escape(message).replace("…", "…+") + r"(?:$|…|[;,: ].*)", re.DOTALL)
    fragments = message.split("…")
    candidates = (text for text in strings_of_the_source() if all(fragment in text for fragment in fragments))
    return any(pattern.fullmatch(text) for text in candidates)


def test_quoted_messages_occur_in_the_source_and_others_do_not() -> None:
    assert [message for message in QUOTED if not occurs(message)] == []
    assert len(QUOTED) > 60
    assert len(set(QUOTED)) == len(QUOTED)
    assert not occurs("no such vehicle")
    assert not occurs("hardly mov")


def test_every_message_is_explained():
    parts = re.split(r"^#### .*$", PAGE, flags=re.MULTILINE)[1:]
    assert all(len(part.split("\n## ")[0].split()) >= 8 for part in parts)
