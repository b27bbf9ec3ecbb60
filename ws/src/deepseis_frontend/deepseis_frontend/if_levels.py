"""Whether the levels of a recording are possible for the format it is said to have.

IF samples are noise that looks the same in every place of a byte and spreads around zero; bytes
read in a wrong format do not. The limits are loose: what a jammed or badly set front end gives
passes, what is plainly something else does not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepseis_core.if_format import IfFormat

FEWEST_SAMPLES = 16384
SHARE_DIFFERENCE = 0.12  # share of samples that differ between the places of a byte
CORRELATION_DIFFERENCE = 0.25  # 4 sigma of 2000 samples a place, and room
OUTER_SHARE = 0.2  # of 8 and 16 bits beyond 3/4 of full scale (Gaussian: 0.13 at half scale rms)
BIAS = 3.0  # mean over standard deviation
FEW_VALUES = 64
BROAD_RMS = 1024.0  # of 16 bits: from here on the low byte of a Gaussian is uniform


def implausible(data: NDArray[np.uint8], packing: IfFormat) -> str:
    """Say why ``data`` cannot be samples of ``packing``; empty where nothing speaks against it."""
    count = packing.samples_in(data.size)
    i = np.empty(count, packing.dtype)
    q = None if packing.is_real else np.empty(count, packing.dtype)
    packing.unpack(data, i, q)
    parts = {"I": i, "Q": q} if q is not None else {"": i}
    for name, part in parts.items():
        label = f"its {name} samples" if name else "its samples"
        if count and part.min() == part.max():
            return f"{label} are constant ({int(part[0])})"
        if count >= FEWEST_SAMPLES:
            reason = _wide(part, packing) if packing.bits >= 8 else _places(part, packing)
            if reason:
                return f"{label} {reason}"
    if count >= FEWEST_SAMPLES and q is not None and _spread_between(i, q, packing):
        return "I and Q are related differently in different places of a byte"
    return ""


def _wide(part: NDArray[Any], packing: IfFormat) -> str:
    """Look at 8 or 16 bits: amplitude, bias, and two samples taken for one."""
    full = 1 << (packing.bits - 1)
    values = part.astype(np.float64)
    outer = float(np.mean(np.abs(values) >= 0.75 * full))
    if outer > OUTER_SHARE:
        return f"lie beyond 3/4 of full scale {100 * outer:.0f} % of the time"
    if abs(values.mean()) > BIAS * values.std():
        return f"have mean {values.mean():.1f} and deviation {values.std():.1f}"
    return "look like two samples of 8 bits each" if packing.bits == 16 and _two(part) else ""


def _two(part: NDArray[Any]) -> bool:
    """Tell whether the low byte of words is a sample of its own.

    With few values, the bytes of two samples occur in all combinations; with many, the low byte
    of one broad distribution is uniform over the multiples of the converter's step.
    """
    words = np.unique(part.view(np.uint16))
    low, high = np.unique(words & 0xFF), np.unique(words >> 8)
    step = 256 // low.size
    if words.size <= FEW_VALUES:
        return (
            low.size > 1 and words.size == low.size * high.size and bool((low % step != 0).any())
        )
    if np.std(part.astype(np.float64)) < BROAD_RMS:
        return False
    histogram = np.bincount(part.view(np.uint16) & 0xFF, minlength=256)
    grid = int(np.gcd.reduce(low[low > 0], initial=256))
    return bool(histogram.max() > 3 * part.size * grid / 256)


def _places(part: NDArray[Any], packing: IfFormat) -> str:
    """Compare the places in a unit, which all hold the same signal."""
    places = packing.samples_per_unit
    if places == 1:
        return ""
    grid = part[: part.size // places * places].reshape(-1, places)
    levels = np.unique(packing.level_of_code)
    share = np.array([(grid == level).mean(axis=0) for level in levels])
    difference = 0.5 * np.abs(share[:, :, None] - share[:, None, :]).sum(axis=0).max()
    if difference > SHARE_DIFFERENCE:
        return f"differ between places of a byte by {100 * difference:.0f} %"
    if _spread_between(part[:-1], part[1:], packing):
        return "follow each other differently in different places of a byte"
    return ""


def _spread_between(a: NDArray[Any], b: NDArray[Any], packing: IfFormat) -> bool:
    """Tell whether the correlation of ``a`` and ``b`` depends on the place in the byte."""
    places = packing.samples_per_unit
    if places == 1:
        return False
    size = min(a.size, b.size) // places * places
    x, y = (part[:size].reshape(-1, places).astype(np.float64) for part in (a, b))
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    power = np.sqrt((x * x).mean(axis=0) * (y * y).mean(axis=0))
    correlation = (x * y).mean(axis=0) / np.maximum(power, 1e-9)
    return bool(np.ptp(correlation) > CORRELATION_DIFFERENCE)
