"""Optional dependencies, the extras of pyproject.toml: a missing one ends in one line that says what to install."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from offpiste.errors import OffpisteError


class MissingExtra(OffpisteError):
    """A package that only an extra installs is not there."""


@contextmanager
def extra(name: str, *, otherwise: str = "") -> Iterator[None]:
    """Context for the imports of an extra's packages.

    Args:
        name: the extra in pyproject.toml.
        otherwise: what to do instead of installing it.

    Raises:
        MissingExtra: a package imported inside is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise missing(name, error.name or "a package", otherwise) from error


def require(name: str, module: str, *, otherwise: str = "") -> None:
    """Check that an extra is installed, before work that needs it at the end.

    Raises:
        MissingExtra: `module`, which the extra installs, is not there.
    """
    if not is_installed(module):
        raise missing(name, module, otherwise)


def is_installed(module: str) -> bool:
    """Whether a top-level module can be imported."""
    return find_spec(module) is not None


def missing(name: str, module: str, otherwise: str = "") -> MissingExtra:
    """The error for an extra that is not installed."""
    how = f"pip install 'offpiste[{name}]'" + (f", or {otherwise}" if otherwise else "")
    return MissingExtra(f"this needs the extra '{name}' ({module} is not installed)", how=how)
