"""Tells a node that stands still from one that waits: the others, before it, go on."""

from __future__ import annotations

from collections.abc import Sequence

LIMIT_SECONDS = 20.0
"""A node that lives and has said nothing for so long of the source's time stands still [s].

Every node reports once a second; on a machine with a load of 20 one was silent for 14 s."""


class Silence:
    """Who has not been heard of for too long, by the source's time.

    Parameters
    ----------
    limit_s : float, optional
        Silence that is too long [s].

    Examples
    --------
    >>> silence = Silence(limit_s=20.0)
    >>> for name in ("trackers", "pvt"):
    ...     silence.hear(name, 1.0)
    >>> silence.hear("pvt", 15.0)
    >>> silence.broken(["trackers", "pvt"], 20.0), silence.broken(["trackers", "pvt"], 22.0)
    (None, 'trackers')
    """

    def __init__(self, limit_s: float = LIMIT_SECONDS) -> None:
        self.limit_s = limit_s
        self._heard_s: dict[str, float] = {}

    def hear(self, name: str, now_s: float) -> None:
        """Note that a node has said something, at a time of the source [s]."""
        self._heard_s[name] = now_s

    def forget(self, name: str) -> None:
        """Let a node be silent: it is dead, or begins."""
        self._heard_s.pop(name, None)

    def broken(self, names: Sequence[str], now_s: float) -> str | None:
        """Name who stands still, of ``names`` in the order of the data, and forget it.

        Those that come later may be silent because of it: their time begins anew.
        """
        for name in names:
            heard_s = self._heard_s.get(name)
            if heard_s is not None and now_s - heard_s > self.limit_s:
                self._heard_s = dict.fromkeys(self._heard_s, now_s)
                self.forget(name)
                return name
        return None
