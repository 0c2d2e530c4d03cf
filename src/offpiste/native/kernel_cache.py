"""Machine code of compiled entries, kept in the user's cache folder: installations may be read-only."""

import hashlib
import logging
import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, Final

from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

from offpiste.core.cache import cache_folder

logger = logging.getLogger(__name__)

DAMAGED: Final = "machine code that was kept cannot be used, and is compiled again"
WAIT: Final = 180.0
"""A process that finds another one compiling the same waits for so long before it compiles as well [s]."""

SILENT: Final = 1.0
"""Time that a process waits for a small kernel of another one before it says so [s]."""


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

    Processes that begin together, as those of a live drive, do not compile the same each: one does, others wait.

    Args:
        function: whose machine code is kept.
        part: of offpiste, for the message; "" for one that compiles so quickly that nothing is said.
        seconds: that all of it takes to compile.
    """

    _impl_class = _Places

    def __init__(self, function: Callable[..., Any], part: str, seconds: int) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._part, self._seconds = part, seconds
        self._turn = _Turn(Path(self.cache_path), f"{function.__module__} {function.__qualname__}", part)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was kept for a signature; None where it has to be compiled."""
        found = self._kept(sig, target_context)
        if found is None:
            self._turn.take(target_context)
            found = self._kept(sig, target_context)  # what another process has left meanwhile
        if found is not None:
            self._turn.leave()
        elif self._part:
            _announce(self._part, self._seconds)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, if the folder can be written."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            logger.debug(f"machine code is not kept: {error}")
            self._turn.give_up()
        finally:
            self._turn.leave()

    def compiling(self, compile_: Callable[..., Any]) -> Callable[..., Any]:
        """Numba's compilation, after which others have their turn although it failed."""

        def compiled(*given: Any) -> Any:
            try:
                return compile_(*given)
            except BaseException:
                self._turn.leave()
                raise

        return compiled

    def _kept(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001  (whatever unpickling damaged bytes may raise)
            logger.warning(f"{self.cache_path}: {DAMAGED} ({type(error).__name__})")
            self._forget()
            return None

    def _forget(self) -> None:
        try:
            self.flush()  # type: ignore[no-untyped-call]
        except OSError as error:
            logger.debug(f"damaged machine code stays: {error}")


class _Turn:
    """One process at a time, by a lock that ends with its process; nothing where files cannot be locked.

    Args:
        folder: that machine code is kept in.
        name: of what is compiled.
    """

    def __init__(self, folder: Path, name: str, part: str) -> None:
        self._folder, self._name, self._part = folder, name, part
        self._file: IO[bytes] | None = None

    def take(self, target_context: Any) -> None:
        """Wait for it, but not for ever, and not where nothing can be kept."""
        self.leave()
        machine = target_context.codegen().magic_tuple()  # computers may share the folder
        digest = hashlib.sha256(repr((self._name, machine)).encode()).hexdigest()
        with suppress(ImportError, OSError):
            import fcntl

            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / f"{digest[:16]}.lock"
            self._file = path.open("wb")
            begin, waits = time.monotonic(), False
            end = begin + WAIT
            while time.monotonic() < end and path.exists():
                with suppress(BlockingIOError):
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                if not waits and (self._part or time.monotonic() > begin + SILENT):
                    logger.info(f"waiting for another process, which compiles {self._part or self._name}")
                    waits = True
                time.sleep(0.05)

    def give_up(self) -> None:
        """Let nobody wait any more: what is compiled cannot be kept."""
        if self._file is not None:
            with suppress(OSError):
                Path(self._file.name).unlink()

    def leave(self) -> None:
        """Let others have it."""
        if self._file is not None:
            with suppress(ImportError, OSError):
                import fcntl

                fcntl.flock(self._file, fcntl.LOCK_UN)  # a child that was forked meanwhile has the file, too
            self._file.close()
        self._file = None


@cache
def _announce(part: str, seconds: int) -> None:
    """Once in a process."""
    logger.info(f"compiling {part} once, about {seconds} s; `offpiste warm-up` does it ahead")
