"""Machine code of compiled entries, kept in the user's cache folder: installations may be read-only."""

import logging
import os
from collections.abc import Callable
from functools import cache
from typing import Any, Final

from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

from offpiste.cache import cache_folder

logger = logging.getLogger(__name__)

DAMAGED: Final = "machine code that was kept cannot be used, and is compiled again"


class _UserFolder(UserWideCacheLocator):  # type: ignore[misc]
    """Numba's way to name folders after those of the sources, below offpiste's own."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[no-untyped-call]
        self._cache_path = str(cache_folder() / "kernels" / os.path.basename(self._cache_path))  # noqa: PTH119


class _Places(CompileResultCacheImpl):  # type: ignore[misc]
    """`$NUMBA_CACHE_DIR` where it is set, the user's folder, or beside the sources."""

    _locator_classes = [UserProvidedCacheLocator, _UserFolder, InTreeCacheLocator]  # noqa: RUF012


class KernelCache(FunctionCache):  # type: ignore[misc]
    """Numba's cache of a function, which says what the first call waits for, and survives damage and full disks.

    Args:
        function: whose machine code is kept.
        part: of offpiste, for the message; "" for one that compiles so quickly that nothing is said.
        seconds: that all of it takes to compile.
    """

    _impl_class = _Places

    def __init__(self, function: Callable[..., Any], part: str, seconds: int) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._part, self._seconds = part, seconds

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was kept for a signature; None where it has to be compiled."""
        try:
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001  (whatever unpickling damaged bytes may raise)
            logger.warning(f"{self.cache_path}: {DAMAGED} ({type(error).__name__})")
            self._forget()
            found = None
        if found is None and self._part:
            _announce(self._part, self._seconds)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, if the folder can be written."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            logger.debug(f"machine code is not kept: {error}")

    def _forget(self) -> None:
        try:
            self.flush()  # type: ignore[no-untyped-call]
        except OSError as error:
            logger.debug(f"damaged machine code stays: {error}")


@cache
def _announce(part: str, seconds: int) -> None:
    """Once in a process."""
    logger.info(f"compiling {part} once, about {seconds} s; `offpiste warm-up` does it ahead")
