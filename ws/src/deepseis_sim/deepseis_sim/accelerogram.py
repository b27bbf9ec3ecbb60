"""Records of earthquakes: whatever the archive's format, acceleration east, north and up.

The format is recognised by content. Text formats have readers here (`accelerogram_formats`,
`accelerogram_csmip`); everything else, miniSEED first of all, is read by ObsPy.
"""

from __future__ import annotations

import glob
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.accelerogram_csmip import read_cosmos, read_csmip
from deepseis_sim.accelerogram_formats import Channel, Lines, read_at2, read_geonet, read_knet

MAX_FILE_BYTES: Final = 1 << 29
"""Larger files are no accelerograms."""

ABSENT: Final = "no such file"
"""The reason of the error where nothing is found under a name."""

_SIBLING: Final = re.compile(r"\.(NS|EW|UD)([12]?)$", re.IGNORECASE)


@dataclass(frozen=True)
class Accelerogram:
    """Three components of ground motion at one place, axes east, north, up.

    Attributes
    ----------
    acceleration : ndarray, shape (m, 3)
        As in the file: neither filtered nor freed of its mean [m/s^2].
    rate_hz : float
    source : str
        The format it was read from.
    station : str
        Empty where the file does not say.
    start_utc_ns : int or None
        Unix time of the first sample.
    latitude_deg, longitude_deg : float or None
    corrected : bool
        Whether the provider has filtered it and taken off the baseline.
    oriented : bool
        Whether the azimuths of its horizontal axes are known.
    velocity, displacement : ndarray, shape (m, 3), or None
        What the provider publishes with it [m/s], [m].
    """

    acceleration: FloatArray
    rate_hz: float
    source: str
    station: str = ""
    start_utc_ns: int | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    corrected: bool = False
    oriented: bool = True
    velocity: FloatArray | None = None
    displacement: FloatArray | None = None


def read_accelerogram(
    path: str | Path | Sequence[str | Path],
    *,
    scale: float | None = None,
    azimuth_deg: float = 0.0,
) -> Accelerogram:
    """Read a record of three components.

    Parameters
    ----------
    path : path or sequence of paths
        One file that holds all components; files of one component each; one of K-NET's three
        files, or what their names have in common; a pattern (``RSN1085_*.AT2``); or a folder
        that holds one record.
    scale : float, optional
        m/s^2 per count, for formats that ObsPy reads (miniSEED holds counts).
    azimuth_deg : float
        Azimuth of the first horizontal axis, where the file does not say; the second lies 90
        degrees clockwise.
    """
    try:
        files = _files(path)
    except (OSError, ValueError) as error:  # a name that no file can have, a locked folder
        raise InputError(path, f"cannot be read: {error}") from None
    channels = [channel for file in files for channel in _read_file(file, scale)]
    name = files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
    return _assemble(channels, azimuth_deg, str(name))


def _files(path: str | Path | Sequence[str | Path]) -> list[Path]:
    """Find the files of a record."""
    if not isinstance(path, str | Path):
        if not path:
            raise InputError("accelerogram", "no files are named")
        return [Path(item) for item in path]
    one = Path(path)
    if one.is_dir():
        inside = sorted(item for item in one.iterdir() if item.is_file())
        if not inside:
            raise InputError(one, "the folder is empty")
        return _siblings(one, [item for item in inside if _SIBLING.search(item.name)]) or inside
    if one.exists():
        stem, found = one.stem, _SIBLING.search(one.name)
        if found is None:
            return [one]
        near = [item for item in one.parent.iterdir() if item.stem == stem]
        return _siblings(one, [item for item in near if _same_depth(item, found[2])])
    has_wildcard = any(sign in one.name for sign in "*?[")
    if has_wildcard and (matching := sorted(one.parent.glob(one.name))):
        return matching
    near = sorted(one.parent.iterdir()) if one.parent.is_dir() else []
    family = [item for item in near if item.stem == one.name]
    if siblings := _siblings(one, [item for item in family if _SIBLING.search(item.name)]):
        return siblings
    raise InputError(one, ABSENT)


def _same_depth(item: Path, depth: str) -> bool:
    found = _SIBLING.search(item.name)
    return found is not None and found[2] == depth


def _siblings(path: Path, found: list[Path]) -> list[Path]:
    """K-NET's three files among those found; of KiK-net's six those at the surface (2)."""
    surface = [item for item in found if item.suffix.endswith("2")] or found
    if len({item.stem for item in surface}) > 1:
        raise InputError(path, "holds several records", "name one of the files")
    return sorted(surface)


def _read_file(path: Path, scale: float | None) -> list[Channel]:
    try:
        if not path.is_file():
            raise InputError(path, "is no file" if path.exists() else ABSENT)
        if path.stat().st_size > MAX_FILE_BYTES:
            raise InputError(path, "is too large for an accelerogram")
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read: {error}") from None
    text = content.decode("latin-1")
    beginning = text[:2000].lower()
    lines = Lines(path, text)
    if beginning.startswith("origin time") and "station code" in beginning:
        return read_knet(lines)
    if re.match(r"\s*(unc|c)orrected accelerogram[^\n]*\n\s*site ", beginning):
        return read_geonet(lines)
    if re.match(r"[^\n]*\(format v\S+ with \d+ text lines", beginning):
        return read_cosmos(lines)
    if re.match(r"\s*(un)?corrected accelerogram", beginning):
        return read_csmip(lines)
    if re.match(r"(?:[^\n]*\n){2}[^\n]*acceleration time[^\n]*units of g", beginning):
        return read_at2(lines)
    if b"obspy.core.stream" in content[:100]:  # ObsPy would run what a pickle says
        raise InputError(path, "pickled streams are not read", "write it as miniSEED")
    return _read_by_obspy(path, scale)


def _read_by_obspy(path: Path, scale: float | None) -> list[Channel]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's own, at import and about headers
        import obspy  # type: ignore[import-untyped]

        try:
            stream = obspy.read(glob.escape(str(path)), check_compression=False)
            stream.merge(method=-1)  # joins what touches; filling a gap might take any memory
        except Exception as error:  # its readers raise whatever comes
            reason = (str(error).strip() or type(error).__name__).split("\n")[0]
            raise InputError(path, f"in no known format of accelerograms: {reason}") from None
    names = [trace.id for trace in stream]
    for name in names:
        if names.count(name) > 1:
            raise InputError(path, f"{name} has gaps")
    return [_channel_of_trace(path, trace, scale) for trace in stream]


def _channel_of_trace(path: Path, trace: Any, scale: float | None) -> Channel:
    stats = trace.stats
    if scale is None and stats.calib == 1.0:
        raise InputError(path, f"{trace.id} is in counts", "give the scale in m/s^2 per count")
    values = np.asarray(trace.data)
    if values.dtype.kind not in "iuf" or not np.isfinite(values).all():
        raise InputError(path, f"the samples of {trace.id} are no numbers")
    axes: dict[str, float | str] = {
        "E": 90.0,
        "N": 0.0,
        "Z": "up",
        "1": "h1",
        "2": "h2",
        "3": "up",
    }
    direction = axes.get(str(stats.channel)[-1:].upper())
    if direction is None:
        raise InputError(path, f"unknown direction of channel {stats.channel!r}")
    return Channel(
        direction=direction,
        acceleration=values.astype(np.float64) * (stats.calib if scale is None else scale),
        rate_hz=float(stats.sampling_rate),
        source=str(stats.get("_format", "ObsPy")),
        station=str(stats.station),
        start_utc_ns=int(stats.starttime.ns),
    )


def _assemble(channels: list[Channel], azimuth_deg: float, name: str) -> Accelerogram:
    """Bring three channels to common times and to east, north, up."""
    vertical = [item for item in channels if item.direction == "up"]
    horizontal = [item for item in channels if item.direction != "up"]
    if (len(vertical), len(horizontal)) != (1, 2):
        counted = f"{len(vertical)} vertical and {len(horizontal)} horizontal components"
        raise InputError(name, f"{counted}; one and two are needed")
    three = [*horizontal, *vertical]
    rate = three[0].rate_hz
    if not 1.0 <= rate <= 1e5:
        raise InputError(name, f"a sampling rate of {rate:g} Hz")
    if any(abs(item.rate_hz / rate - 1) > 1e-6 for item in three):
        rates = ", ".join(f"{item.rate_hz:g}" for item in three)
        raise InputError(name, f"sampling rates of the components differ: {rates} Hz")
    skip, length = _common_span(three, name)
    turn, oriented = _rotation(horizontal, azimuth_deg, name)

    def enu(kind: str) -> FloatArray | None:
        rows = [getattr(item, kind) for item in three]
        if any(row is None for row in rows):
            return None
        cut = [row[first : first + length] for row, first in zip(rows, skip, strict=True)]
        return np.ascontiguousarray(np.stack(cut, axis=1) @ turn.T)

    acceleration = enu("acceleration")
    assert acceleration is not None
    start = three[0].start_utc_ns
    return Accelerogram(
        acceleration=acceleration,
        rate_hz=rate,
        source=three[0].source,
        station=three[0].station,
        start_utc_ns=None if start is None else start + round(skip[0] * 1e9 / rate),
        latitude_deg=three[0].latitude_deg,
        longitude_deg=three[0].longitude_deg,
        corrected=all(item.corrected for item in three),
        oriented=oriented,
        velocity=enu("velocity"),
        displacement=enu("displacement"),
    )


def _common_span(three: list[Channel], name: str) -> tuple[list[int], int]:
    """Whole samples to skip in each channel so that all begin together, and the length."""
    starts = [item.start_utc_ns for item in three]
    known = [start for start in starts if start is not None]
    latest = max(known) if len(known) == 3 else 0
    skip = [
        round((latest - start) * 1e-9 * three[0].rate_hz) if start is not None and latest else 0
        for start in starts
    ]
    length = min(item.acceleration.size - first for item, first in zip(three, skip, strict=True))
    if length < 2:
        raise InputError(name, "its components have no time in common")
    return skip, length


def _rotation(horizontal: list[Channel], azimuth_deg: float, name: str) -> tuple[FloatArray, bool]:
    """Matrix (3, 3) from the channels, the vertical last, to east, north, up."""
    assumed = {"h1": azimuth_deg, "h2": azimuth_deg + 90.0}
    oriented = all(not isinstance(item.direction, str) for item in horizontal)
    azimuth = np.radians([float(assumed.get(str(c.direction), c.direction)) for c in horizontal])
    axes = np.eye(3)
    axes[:2, 0], axes[:2, 1] = np.sin(azimuth), np.cos(azimuth)
    if abs(np.linalg.det(axes)) < 0.5:
        raise InputError(name, "its horizontal components point the same way")
    turn: FloatArray = np.linalg.inv(axes).astype(np.float64)
    return turn, oriented
