"""Cache of compiled entries in the user's cache folder, since installations may be read-only."""

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

WAIT: Final = 180.0
"""Longest wait for another process that compiles the same kernel [s]."""

SILENT: Final = 1.0
"""Wait for a small kernel before a message [s]."""


class _UserFolder(UserWideCacheLocator):  # type: ignore[misc]
    """Numba's folder of a source file, below the cache folder of offpiste."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[no-untyped-call]
        self._cache_path = str(cache_folder() / "kernels" / os.path.basename(self._cache_path))  # noqa: PTH119


class _Places(CompileResultCacheImpl):  # type: ignore[misc]
    """Cache in `$NUMBA_CACHE_DIR`, the user's folder, or beside the sources."""

    _locator_classes = [UserProvidedCacheLocator, _UserFolder, InTreeCacheLocator]  # noqa: RUF012


class KernelCache(FunctionCache):  # type: ignore[misc]
    """Numba's cache of a function, which announces compilation and tolerates damage and full disks.

    If several processes need the same function, as in a live drive, one compiles it and the others wait.

    Args:
        part: name of the function's group for the message; "" for no message.
        seconds: duration of compiling the group.
    """

    _impl_class = _Places

    def __init__(self, function: Callable[..., Any], part: str, seconds: int) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._part, self._seconds = part, seconds
        self._lock = _Lock(Path(self.cache_path), f"{function.__module__} {function.__qualname__}", part)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the cached code of a signature; None if it must be compiled."""
        found = self._kept(sig, target_context)
        if found is None:
            self._lock.acquire(target_context)
            found = self._kept(sig, target_context)  # another process may have compiled it
        if found is not None:
            self._lock.release()
        elif self._part:
            _announce(self._part, self._seconds)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Cache compiled code if the folder is writable."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            logger.debug(f"machine code is not cached: {error}")
            self._lock.give_up()
        finally:
            self._lock.release()

    def compiling(self, compile_: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap Numba's compilation so that its failure releases the lock."""

        def compiled(*given: Any) -> Any:
            try:
                return compile_(*given)
            except BaseException:
                self._lock.release()
                raise

        return compiled

    def _kept(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception as error:  # noqa: BLE001  (unpickling damaged bytes raises anything)
            logger.warning(
                f"{self.cache_path}: cached machine code cannot be used and is compiled again ({type(error).__name__})"
            )
            self._forget()
            return None

    def _forget(self) -> None:
        try:
            self.flush()  # type: ignore[no-untyped-call]
        except OSError as error:
            logger.debug(f"damaged machine code remains: {error}")


class _Lock:
    """File lock for one compiling process at a time; without effect if files cannot be locked."""

    def __init__(self, folder: Path, name: str, part: str) -> None:
        self._folder, self._name, self._part = folder, name, part
        self._file: IO[bytes] | None = None

    def acquire(self, target_context: Any) -> None:
        """Wait for the lock, at most `WAIT` seconds, and not after `give_up`."""
        self.release()
        machine = target_context.codegen().magic_tuple()  # machines may share the folder
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
        """End the wait of others, since the code cannot be cached."""
        if self._file is not None:
            with suppress(OSError):
                Path(self._file.name).unlink()

    def release(self) -> None:
        """Release the lock."""
        if self._file is not None:
            with suppress(ImportError, OSError):
                import fcntl

                fcntl.flock(self._file, fcntl.LOCK_UN)  # a forked child has the file open, too
            self._file.close()
        self._file = None


@cache
def _announce(part: str, seconds: int) -> None:
    """Announce compilation once per process."""
    logger.info(f"compiling {part} once, about {seconds} s; `offpiste warm-up` does it ahead")
