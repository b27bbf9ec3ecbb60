"""A file that grows by whole pieces: one that cannot be written leaves no part of itself."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from deepseis_core.errors import DiskError


class WholeWrites:
    """A new file, locked while it is open, to which pieces are added whole or not at all.

    A piece is what was :meth:`put` since the last :meth:`commit`.

    Parameters
    ----------
    path : path
        File to be made; it must not exist.
    sync_interval : float
        How often the disk is told to keep what it has, against a loss of power; 0: never [s].

    Attributes
    ----------
    written : int
        Bytes in the file.
    position : int
        Where the next byte of the piece will stand.
    guard : callable or None
        Called before each piece is written; an ``OSError`` of it counts as the disk's.

    Raises
    ------
    DiskError
        Where the file cannot be made.
    """

    def __init__(self, path: Path, *, sync_interval: float = 0.0) -> None:
        self.written = self.position = 0
        self.guard: Callable[[], None] | None = None
        self._piece: list[bytes | bytearray] = []
        self._sync_interval, self._synced = sync_interval, time.monotonic()
        try:
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise DiskError(path, f"cannot be made: {error.strerror}") from None
        with suppress(OSError):  # tells `recover` that somebody writes; not everywhere possible
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def put(self, data: bytes | bytearray) -> None:
        """Add bytes to the piece."""
        self._piece.append(data)
        self.position += len(data)

    def commit(self) -> None:
        """Write the piece; where that raises ``OSError`` the file is as it was, the piece lost."""
        data, guard = memoryview(b"".join(self._piece)), self.guard
        self._piece.clear()
        try:
            if guard is not None:  # another thread may take it away meanwhile
                guard()
            while len(data):
                data = data[self._file.write(data) :]
        except OSError:
            self.position = self.written
            with suppress(OSError):
                self._file.truncate(self.written)
                self._file.seek(self.written)
            raise
        self.written = self.position
        self._sync()

    def _sync(self) -> None:
        """Tell the disk to keep what it has, if it is time."""
        if 0 < self._sync_interval < time.monotonic() - self._synced:
            self._synced = time.monotonic()
            with suppress(OSError):
                os.fdatasync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()
