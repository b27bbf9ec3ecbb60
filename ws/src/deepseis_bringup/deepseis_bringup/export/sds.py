"""The SeisComP Data Structure: a day file for each channel, grown by whole records."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_bringup.export.fdsn_channels import ChannelCode, Place
from deepseis_bringup.export.miniseed import RECORD_BYTES, SEQUENCES, day_records
from deepseis_bringup.export.sample_runs import Run
from deepseis_bringup.export.utc_pieces import DAY_NS
from deepseis_core.errors import InputError

TYPE: Final = "D"


def sds_path(place: Place, channel: ChannelCode, day_ns: int) -> Path:
    """Return a day's file below the archive's root.

    Parameters
    ----------
    day_ns : int
        Midnight, UTC [ns since 1970].
    """
    date = np.datetime64(day_ns // DAY_NS, "D")
    year = date.astype("datetime64[Y]")
    number = int((date - year).astype(int)) + 1
    folder = Path(str(year), place.network, place.station, f"{channel.code}.{TYPE}")
    ids = (place.network, place.station, channel.location, channel.code)
    return folder / ".".join((*ids, TYPE, str(year), f"{number:03d}"))


class SdsArchive:
    """Appends runs to an archive; a file never ends within a record of ours.

    Records go to the system as soon as they are whole. What a killed writer left of one is cut
    off when its file is opened again.

    Parameters
    ----------
    root : path
        Folder of the archive, made if need be.
    place : Place, optional
        Codes of the station; only `write` needs them.
    """

    def __init__(self, root: Path, place: Place | None = None) -> None:
        self.root, self.place = root, place
        self.records = 0
        self.paths: dict[Path, None] = {}

    def write(self, run: Run, channels: tuple[ChannelCode, ...]) -> None:
        """Append a run, one channel for each column of its values."""
        assert self.place is not None
        for column, channel in enumerate(channels):
            parts: dict[int, bytearray] = {}
            sequence = self.records % SEQUENCES + 1
            for day_ns, data in day_records(run, column, channel, self.place, sequence):
                parts.setdefault(day_ns, bytearray()).extend(data)
                self.records += len(data) // RECORD_BYTES
            for day_ns, records in parts.items():
                self.append(sds_path(self.place, channel, day_ns), bytes(records))

    def append(self, name: Path, records: bytes) -> None:
        """Append whole records to a file of the archive."""
        path = self.root / name
        try:
            if path not in self.paths:
                path.parent.mkdir(parents=True, exist_ok=True)
                _cut_to_records(path)
                self.paths[path] = None
            with path.open("ab", buffering=0) as file:
                if file.write(records) != len(records):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise InputError(path, f"cannot be written: {error.strerror}") from None


def _cut_to_records(path: Path) -> None:
    if path.exists() and (size := path.stat().st_size) % RECORD_BYTES:
        os.truncate(path, size - size % RECORD_BYTES)
