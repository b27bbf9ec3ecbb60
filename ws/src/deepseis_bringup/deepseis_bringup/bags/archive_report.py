"""What is to be said of disk and archive: as diagnostics, and as an estimate beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from deepseis_bringup.bags.archive import ArchiveConfig, DiskState

OK, WARN, ERROR = range(3)
SOON_S: Final = 3600.0
"""A disk that is full sooner than this is warned of [s]."""
REST_BYTES_PER_S: Final = 60_000.0
"""All topics but the samples, ten satellites and an IMU at 200 Hz, compressed [bytes/s]."""


@dataclass(frozen=True)
class DiskReport:
    """One status: level, text, and the figures behind it."""

    level: int
    text: str
    values: dict[str, object]


def growth_left(config: ArchiveConfig, size: float, bytes_per_s: float) -> float:
    """Return how much the bag will still grow before the ring holds it; inf: without end.

    Examples
    --------
    >>> growth_left(ArchiveConfig(split_s=60, keep_h=1), 1e6, 1e3)
    2600000.0
    """
    limits = [math.inf]
    if config.budget_gb:
        limits.append(config.budget_gb * 1e9)
    if config.keep_h:
        limits.append(config.keep_h * 3600 * bytes_per_s)
    return max(0.0, min(limits) - size)


def full_in(config: ArchiveConfig, free: float, size: float, bytes_per_s: float) -> float:
    """Return the time until recording stops for lack of room; inf: never [s]."""
    room = free - config.min_free_mb * 1e6
    if bytes_per_s <= 0 or growth_left(config, size, bytes_per_s) <= room:
        return math.inf
    return max(0.0, room) / bytes_per_s


def disk_report(config: ArchiveConfig, state: DiskState, began_ns: int) -> DiskReport:
    """Put the state of disk and archive into a status.

    Parameters
    ----------
    config : ArchiveConfig
    state : DiskState
    began_ns : int
        Stamp of the first message.

    Returns
    -------
    DiskReport
        ERROR while nothing can be written; WARN after a loss, or an hour before the disk is full.
    """
    past = (state.newest_ns - began_ns) / 1e9
    rate = state.written / past if past > 1.0 else 0.0
    left = full_in(config, state.free, state.size, rate)
    kept = (state.newest_ns - state.oldest_ns) / 3.6e12
    values: dict[str, object] = {
        "free_gb": f"{state.free / 1e9:.3f}",
        "bag_gb": f"{state.size / 1e9:.3f}",
        "mb_per_s": f"{rate / 1e6:.3f}",
        "full_in_h": f"{left / 3600:.2f}",
        "kept_h": f"{kept:.3f}",
        "files": state.files,
        "files_kept_for_events": state.kept_for_events,
        "files_deleted": state.deleted,
        "messages_lost": state.lost,
    }
    lost = f", {state.lost} messages lost" if state.lost else ""
    if state.trouble:
        return DiskReport(ERROR, f"not recording: {state.trouble}{lost}", values)
    text = f"{state.free / 1e9:.1f} GB free, {kept:.2f} h in {state.files} files"
    if left < SOON_S:
        return DiskReport(WARN, f"disk full in {left / 60:.0f} min: {text}{lost}", values)
    return DiskReport(WARN if state.lost else OK, text + lost, values)


def estimate(config: ArchiveConfig, samples_bytes_per_s: float, free: float) -> list[str]:
    r"""Say beforehand what a recording will take, and whether it fits.

    Parameters
    ----------
    config : ArchiveConfig
    samples_bytes_per_s : float
        IF samples recorded a second; 0: none [bytes/s].
    free : float
        On the disk [bytes].

    Examples
    --------
    >>> config = ArchiveConfig(split_s=60, budget_gb=100)
    >>> print("\n".join(estimate(config, 8e6, 50e9)))
    recording takes at most 8.06 MB/s, 29.0 GB an hour, 696 GB a day
    50 GB are free, the archive grows to 100 GB: the disk is full in 1.7 h
    """
    rate = samples_bytes_per_s + REST_BYTES_PER_S
    lines = [
        f"recording takes at most {rate / 1e6:.3g} MB/s, {rate * 3.6e3 / 1e9:.1f} GB an hour, "
        f"{rate * 8.64e4 / 1e9:.3g} GB a day"
    ]
    left, growth = full_in(config, free, 0.0, rate), growth_left(config, 0.0, rate)
    size = f", the archive grows to {growth / 1e9:.3g} GB" if math.isfinite(growth) else ""
    fits = f"the disk is full in {left / 3600:.1f} h" if math.isfinite(left) else "it fits"
    return [*lines, f"{free / 1e9:.3g} GB are free{size}: {fits}"]
