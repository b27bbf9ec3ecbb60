"""How long something took, over the last second: median, 99th percentile and longest."""

from __future__ import annotations

from collections import deque

import numpy as np


class LatencyMeter:
    """Collects times and sums them up.

    Examples
    --------
    >>> meter = LatencyMeter()
    >>> for milliseconds in range(1, 101):
    ...     meter.add(1e-3 * milliseconds)
    >>> meter.summary()
    {'count': '100', 'median_ms': '50.50', 'p99_ms': '99.01', 'max_ms': '100.00'}
    >>> meter.summary()
    {}
    """

    def __init__(self) -> None:
        self._seconds: list[float] = []

    def add(self, seconds: float) -> None:
        """Take one."""
        self._seconds.append(seconds)

    def summary(self) -> dict[str, str]:
        """Return what came since the last call; empty if nothing did."""
        if not self._seconds:
            return {}
        found = 1e3 * np.array(self._seconds)
        self._seconds.clear()
        median, p99 = np.percentile(found, [50.0, 99.0])
        return {
            "count": str(len(found)),
            "median_ms": f"{median:.2f}",
            "p99_ms": f"{p99:.2f}",
            "max_ms": f"{found.max():.2f}",
        }


class Arrivals:
    """When what is valid through a sample came, asked for in order of the sample.

    Examples
    --------
    >>> arrivals = Arrivals()
    >>> arrivals.note(100, 5.0)
    >>> arrivals.note(200, 6.0)
    >>> arrivals.of(150), arrivals.of(200), arrivals.of(201)
    (6.0, 6.0, None)
    """

    def __init__(self, room: int = 1000) -> None:
        self._noted: deque[tuple[int, float]] = deque(maxlen=room)

    def note(self, through: int, now: float) -> None:
        """Something came."""
        self._noted.append((through, now))

    def of(self, sample: int) -> float | None:
        """Return when the first that reaches to a sample came; None: it has not."""
        while self._noted and self._noted[0][0] < sample:
            self._noted.popleft()
        return self._noted[0][1] if self._noted else None
