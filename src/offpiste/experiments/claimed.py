"""A folder that belongs to an experiment with these settings, and to no other."""

import json
from pathlib import Path
from typing import Any

from offpiste.errors import RunError
from offpiste.training.checkpoint import load_json, save_json


def claim_folder(out: Path, described: dict[str, Any]) -> None:
    """Say in `out/settings.json` what the folder is of, or check that it is of this.

    Raises:
        RunError: it was begun with other settings.
    """
    path, described = out / "settings.json", json.loads(json.dumps(described))
    if not path.exists():
        save_json(path, described)
        return
    found = load_json(path)
    other = [key for key in sorted({*found, *described}) if found.get(key) != described.get(key)]
    if other:
        other = [name for key in other for name in _differing(key, found.get(key), described.get(key))]
        raise RunError(
            f"was begun with other settings ({', '.join(other)})",
            where=out,
            how="give the same again, or choose another --out",
        )


def _differing(name: str, found: Any, asked: Any) -> list[str]:
    """Names of what differs, inside of a table of settings by its own keys."""
    if not (isinstance(found, dict) and isinstance(asked, dict)):
        return [name]
    return [f"{name}.{key}" for key in sorted({*found, *asked}) if found.get(key) != asked.get(key)]
