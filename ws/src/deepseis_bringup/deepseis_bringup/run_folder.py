"""The folder that a command leaves: made new, never half-written."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from deepseis_bringup.supervisor import NodeFailureError, StandstillError
from deepseis_core.errors import DiskError, InputError


def new_run_folder(chosen: Path | None) -> Path:
    """Return the run folder to be made.

    Raises
    ------
    InputError
        It exists and is not empty, or cannot be looked at.
    """
    folder = chosen or Path("runs") / datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    try:
        if folder.exists() and not folder.is_dir():
            raise InputError(folder, "is a file", "name a new folder with -o")
        if folder.exists() and any(folder.iterdir()):
            raise InputError(folder, "exists and is not empty", "name a new folder with -o")
    except OSError as error:
        raise InputError(folder, f"cannot be used: {error.strerror}") from None
    return folder


def is_worth_keeping(folder: Path, error: BaseException) -> bool:
    """Whether a failed run is a record of something: a failure, a standstill, samples."""
    if isinstance(error, InputError):
        return isinstance(error, (NodeFailureError, StandstillError, DiskError))
    return any(path.stat().st_size > 65536 for path in folder.glob("bag/*.mcap"))


def never(_folder: Path, _error: BaseException) -> bool:
    """Keep nothing."""
    return False


@contextmanager
def half_written_is_removed(
    folder: Path, *, keep: Callable[[Path, BaseException], bool] = is_worth_keeping
) -> Iterator[None]:
    """Make a folder; remove what is in it if the work within fails, unless ``keep`` says so."""
    existed = folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be made: {error.strerror}") from None
    try:
        yield
    except BaseException as error:
        if isinstance(error, OSError) and not error.filename:
            error.filename = str(folder)  # a write that fails does not say where
        if not keep(folder, error):
            _remove(folder, itself=not existed)
        raise


def _remove(folder: Path, *, itself: bool) -> None:
    if itself:
        shutil.rmtree(folder, ignore_errors=True)
        return
    for path in folder.iterdir():
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()
