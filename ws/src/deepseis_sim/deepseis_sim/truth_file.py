"""An ``.npz`` file that grows on disk, not in memory."""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_DATE = (1980, 1, 1, 0, 0, 0)  # of every member: same content, same bytes


@dataclass
class _Growing:
    """An array that grows: its rows so far lie in a file."""

    file: BinaryIO
    dtype: np.dtype[Any]
    row_shape: tuple[int, ...]
    rows: int = 0

    def write_header(self, target: IO[bytes]) -> None:
        shape = (self.rows, *self.row_shape)
        descr = np.lib.format.dtype_to_descr(self.dtype)
        header = {"descr": descr, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(target, header)


class TruthFile:
    """Collects arrays row by row, then stores them as one ``.npz``.

    Parameters
    ----------
    path : path
        The file to be; until the end of the ``with`` its parts lie in a hidden folder beside it.

    Examples
    --------
    >>> with TemporaryDirectory() as folder:
    ...     with TruthFile(Path(folder) / "a.npz") as truth:
    ...         truth.append(x=np.array([1.0]))
    ...         truth.append(x=np.array([2.0]))
    ...     np.load(Path(folder) / "a.npz")["x"].tolist()
    [1.0, 2.0]
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._folder = TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent)
        self._growing: dict[str, _Growing] = {}

    def _member(self, name: str) -> Path:
        return Path(self._folder.name) / f"{name}.npy"

    def put(self, **arrays: Any) -> None:
        """Store arrays that do not grow."""
        for name, value in arrays.items():
            np.save(self._member(name), np.asarray(value), allow_pickle=False)

    def append(self, **arrays: NDArray[Any]) -> None:
        """Append rows to arrays that grow, each at its own pace."""
        for name, value in arrays.items():
            array = np.ascontiguousarray(value)
            if name not in self._growing:
                file = (Path(self._folder.name) / f"{name}.rows").open("wb")
                self._growing[name] = _Growing(file, array.dtype, array.shape[1:])
            growing = self._growing[name]
            growing.file.write(array.tobytes())
            growing.rows += len(array)

    def __enter__(self) -> TruthFile:
        """Return itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Store the file, or leave nothing behind after an error."""
        try:
            for growing in self._growing.values():
                growing.file.close()
            if kind is None:
                self._store()
        finally:
            self._folder.cleanup()

    def _store(self) -> None:
        """Collect the parts: whole arrays as they are, growing ones behind their header."""
        part = self.path.with_name(f".{self.path.name}.part")
        try:
            with zipfile.ZipFile(part, "w", allowZip64=True) as archive:
                for member in sorted(Path(self._folder.name).iterdir()):
                    info = zipfile.ZipInfo(f"{member.stem}.npy", _DATE)
                    with (
                        member.open("rb") as source,
                        archive.open(info, "w", force_zip64=True) as target,
                    ):
                        if member.suffix == ".rows":
                            self._growing[member.stem].write_header(target)
                        shutil.copyfileobj(source, target, 1 << 20)
            part.replace(self.path)
        finally:
            part.unlink(missing_ok=True)
