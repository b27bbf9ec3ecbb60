"""Which ephemeris counts for which sample: the order of arrival must not matter."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from deepseis_core.constants import NS_PER_S, NS_PER_WEEK
from deepseis_core.ephemeris import pack
from deepseis_core.types import Ephemeris, FloatArray


class EphemerisBook:
    """Ephemerides of all satellites, each used from its ``effective_sample_index`` on.

    Parameters
    ----------
    max_age : float
        Greatest distance from toe [s].
    use_unhealthy : bool, optional
        Whether satellites that say they are unhealthy take part.
    """

    def __init__(self, max_age: float, use_unhealthy: bool = False) -> None:
        self._max_age_ns = round(max_age * NS_PER_S)
        self._use_unhealthy = use_unhealthy
        self._known: dict[str, list[tuple[Ephemeris, FloatArray]]] = {}
        self._klobuchar: list[tuple[int, str, FloatArray]] = []

    def add(self, ephemeris: Ephemeris) -> bool:
        """Enter an ephemeris; False if it is there already."""
        known = self._known.setdefault(ephemeris.satellite, [])
        if any(ephemeris == other for other, _ in known):
            return False
        known.append((ephemeris, pack([ephemeris])[0]))
        known.sort(key=lambda item: (item[0].effective_sample_index, _toe_ns(item[0])))
        if ephemeris.iono_alpha and ephemeris.iono_beta:
            self.add_klobuchar(
                ephemeris.iono_alpha,
                ephemeris.iono_beta,
                ephemeris.effective_sample_index,
                ephemeris.satellite,
            )
        return True

    def add_klobuchar(
        self,
        alpha: Iterable[float],
        beta: Iterable[float],
        effective_sample_index: int = -1,
        satellite: str = "",
    ) -> None:
        """Enter ionosphere parameters, used from a sample on."""
        values = np.array([*alpha, *beta], np.float64)
        if values.shape != (8,):
            raise ValueError("the ionosphere has four alpha and four beta")
        entry = (effective_sample_index, satellite)
        if any(item[:2] == entry and np.array_equal(item[2], values) for item in self._klobuchar):
            return
        self._klobuchar.append((*entry, values))
        self._klobuchar.sort(key=lambda item: item[:2])

    def klobuchar(self, sample_index: int) -> FloatArray | None:
        """Return the eight parameters in force, the newest; None before any."""
        chosen = None
        for effective, _, values in self._klobuchar:
            if effective <= sample_index:
                chosen = values
        return chosen

    def find(
        self, satellite: str, sample_index: int, gps_ns: int, *, week_known: bool = True
    ) -> tuple[Ephemeris, FloatArray] | None:
        """Return the ephemeris in force at a sample, and its packed row; None if there is none.

        The nearest toe wins; of equal ones the one that came into force last.

        Parameters
        ----------
        satellite : str
        sample_index : int
            Only ephemerides effective by then count.
        gps_ns : int
            GPS time since its epoch [ns].
        week_known : bool, optional
            False: only the time of week of ``gps_ns`` means something.
        """
        best, best_distance = None, self._max_age_ns
        for item in self._known.get(satellite, ()):
            if item[0].effective_sample_index > sample_index:
                break
            if item[0].health and not self._use_unhealthy:
                continue
            distance = gps_ns - _toe_ns(item[0])
            if not week_known:
                distance = (distance + NS_PER_WEEK // 2) % NS_PER_WEEK - NS_PER_WEEK // 2
            if abs(distance) <= best_distance:
                best, best_distance = item, abs(distance)
        return best

    def forget(self, sample_index: int, gps_ns: int) -> None:
        """Drop what can no longer be chosen from a sample and its GPS time on."""
        oldest = gps_ns - self._max_age_ns
        for name, known in self._known.items():
            self._known[name] = [
                item
                for item in known
                if item[0].effective_sample_index > sample_index or _toe_ns(item[0]) >= oldest
            ]
        past = sum(item[0] <= sample_index for item in self._klobuchar)
        if past > 1:
            del self._klobuchar[: past - 1]


def week_of(ephemeris: Ephemeris, tow_ms: int) -> int:
    """Return the GPS week in which a time of week lies nearest to the ephemeris' toe.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> week_of(SimpleNamespace(week=2190, toe=604784.0), 1000)
    2191
    """
    return ephemeris.week + round((ephemeris.toe * 1000 - tow_ms) / 604_800_000)


def _toe_ns(ephemeris: Ephemeris) -> int:
    return ephemeris.week * NS_PER_WEEK + round(ephemeris.toe * NS_PER_S)
