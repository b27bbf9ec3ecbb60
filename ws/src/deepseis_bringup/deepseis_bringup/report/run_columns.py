"""Messages turned into columns: arrays that grow in blocks, one per field."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

BLOCK: Final = 512  # messages kept apart before they are joined: small arrays cost 100 bytes each
ROW: Final = "row"


class Columns(dict[str, NDArray[Any]]):
    """Fields of one topic as arrays.

    A scalar field has one value for each message, shape (m,), a vector of fixed size (m, k).
    The fields aligned on integrations or satellites are joined end to end, shape (n,); ``row``
    tells the message that each of the n belongs to.
    """

    @property
    def count(self) -> int:
        """Messages."""
        return int(next((len(v) for k, v in self.items() if k.startswith("stamp")), 0))

    def per_row(self, name: str) -> NDArray[Any]:
        """Return a scalar field, repeated for every element of the joined ones."""
        return self[name][self[ROW]]


class ColumnBuilder:
    """Collects messages of one type.

    Parameters
    ----------
    scalars, vectors, joined : iterable of str
        Names of the fields of each kind; the first of ``joined`` gives the length that all of
        them have in a message.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> builder = ColumnBuilder(["mode"], [], ["sample_index"])
    >>> for mode in (1, 3):
    ...     builder.add(7, Message(mode=mode, sample_index=np.arange(mode)))
    >>> columns = builder.finish()
    >>> columns["sample_index"], columns.per_row("mode")
    (array([0, 0, 1, 2]), array([1, 3, 3, 3]))
    """

    def __init__(
        self, scalars: Iterable[str], vectors: Iterable[str] = (), joined: Iterable[str] = ()
    ) -> None:
        self._scalars, self._vectors, self._joined = list(scalars), list(vectors), list(joined)
        names = ["stamp_ns", *self._scalars, *self._vectors, *self._joined, ROW]
        self._loose: dict[str, list[Any]] = {name: [] for name in names}
        self._blocks: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
        self._lengths: list[int] = []
        self._count = 0

    def add(self, stamp_ns: int, message: Any) -> None:
        """Take a message."""
        loose = self._loose
        loose["stamp_ns"].append(stamp_ns)
        for name in (*self._scalars, *self._vectors):
            loose[name].append(getattr(message, name))
        if self._joined:
            self._lengths.append(len(getattr(message, self._joined[0])))
            for name in self._joined:
                loose[name].append(getattr(message, name))
        self._count += 1
        if self._count % BLOCK == 0:
            self._compact()

    def _compact(self) -> None:
        held = len(self._loose["stamp_ns"])
        if not held:
            return
        for name in ("stamp_ns", *self._scalars, *self._vectors):
            self._blocks[name].append(np.array(self._loose[name]))
        if self._joined:
            rows = np.arange(self._count - held, self._count)
            self._blocks[ROW].append(np.repeat(rows, self._lengths))
            for name in self._joined:
                parts = [np.asarray(part) for part in self._loose[name]]
                full = [part for part in parts if part.size]
                self._blocks[name].append(np.concatenate(full) if full else parts[0])
        for values in self._loose.values():
            values.clear()
        self._lengths.clear()

    def finish(self) -> Columns:
        """Return all columns."""
        self._compact()
        columns = Columns()
        for name, blocks in self._blocks.items():
            full = [block for block in blocks if block.size]
            if full:
                columns[name] = np.concatenate(full)
            else:
                columns[name] = blocks[0] if blocks else np.zeros(0)
        columns[ROW] = columns[ROW].astype(np.int64)
        return columns
