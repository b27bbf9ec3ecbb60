"""An ``.npz`` file that grows on disk, not in memory."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_DATE = (1980, 1, 1, 0, 0, 0)  # of every member: same content, same bytes


class TruthFile:
    """Collects arrays row by row, then stores them as one ``.npz``.

    Parameters
    ----------
    path : path
        The file to be; until the end of the ``with`` its parts lie in a hidden folder beside it.
    rows : int
        Rows that every growing array will have in the end.

    Examples
    --------
    >>> with TemporaryDirectory() as folder:
    ...     with TruthFile(Path(folder) / "a.npz", rows=2) as truth:
    ...         truth.append(x=np.array([1.0]))
    ...         truth.append(x=np.array([2.0]))
    ...     np.load(Path(folder) / "a.npz")["x"].tolist()
    [1.0, 2.0]
    """

    def __init__(self, path: Path, rows: int) -> None:
        self.path, self.rows = path, rows
        self._folder = TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent)
        self._files: dict[str, BinaryIO] = {}

    def _member(self, name: str) -> Path:
        return Path(self._folder.name) / f"{name}.npy"

    def put(self, **arrays: Any) -> None:
        """Store arrays that do not grow."""
        for name, value in arrays.items():
            np.save(self._member(name), np.asarray(value), allow_pickle=False)

    def append(self, **arrays: NDArray[Any]) -> None:
        """Append rows to arrays that grow."""
        for name, value in arrays.items():
            if name not in self._files:
                self._files[name] = self._member(name).open("wb")
                header = np.lib.format.header_data_from_array_1_0(value)
                header["shape"] = (self.rows, *value.shape[1:])
                header["fortran_order"] = False
                np.lib.format.write_array_header_1_0(self._files[name], header)
            self._files[name].write(np.ascontiguousarray(value).tobytes())

    def __enter__(self) -> TruthFile:
        """Return itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Store the file, or leave nothing behind after an error."""
        try:
            for file in self._files.values():
                file.close()
            if kind is None:
                self._store()
        finally:
            self._folder.cleanup()

    def _store(self) -> None:
        part = self.path.with_name(f".{self.path.name}.part")
        try:
            with zipfile.ZipFile(part, "w", allowZip64=True) as archive:
                for member in sorted(Path(self._folder.name).iterdir()):
                    info = zipfile.ZipInfo(member.name, _DATE)
                    with member.open("rb") as source, archive.open(info, "w") as target:
                        shutil.copyfileobj(source, target, 1 << 20)
            part.replace(self.path)
        finally:
            part.unlink(missing_ok=True)
