"""Bytes that only grow until they are wanted: beyond a size they wait on the disk."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path
from typing import IO, Final

LARGEST: Final = 1 << 20
"""Kept in memory [B]."""


class SpilledBytes:
    """Gathers bytes; what is more than ``LARGEST`` goes into a file that has no name.

    Where the disk refuses, they stay in memory and it is tried again with the next ones.

    Parameters
    ----------
    folder : Path
        On whose file system the file is made, once it is needed; it goes with the process.
    largest : int, optional
        Kept in memory [B].

    Examples
    --------
    >>> gathered = SpilledBytes(Path(tempfile.gettempdir()), largest=4)
    >>> for part in (b"one", b"two", b"three"):
    ...     gathered.add(part)
    >>> gathered.in_memory, gathered.take()
    (0, b'onetwothree')
    """

    def __init__(self, folder: Path, largest: int = LARGEST) -> None:
        self._folder, self._largest = folder, largest
        self._memory = bytearray()
        self._spilled = 0
        self._file: IO[bytes] | None = None

    @property
    def in_memory(self) -> int:
        """Bytes that are in memory."""
        return len(self._memory)

    def add(self, data: bytes) -> None:
        """Take the next bytes."""
        self._memory += data
        if len(self._memory) > self._largest:
            with suppress(OSError):
                self._spill()

    def close(self) -> None:
        """Give up what has not been taken."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def take(self) -> bytes:
        """Return all of them, in order, and have none any more."""
        spilled = b""
        if self._file is not None:
            self._file.seek(0)
            spilled = self._file.read()[: self._spilled]
        together = spilled + bytes(self._memory)
        self._memory.clear()
        self._spilled = 0
        self.close()
        return together

    def _spill(self) -> None:
        """Move to the file what is in memory; a part that fails is written over the next time."""
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder, buffering=0)  # noqa: SIM115
        self._file.seek(self._spilled)
        data = memoryview(bytes(self._memory))
        while len(data):
            data = data[self._file.write(data) :]
        self._spilled += len(self._memory)
        self._memory.clear()
