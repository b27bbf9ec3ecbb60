"""When a satellite's signal was sent, kept over a loss: found again soon, it is known at once."""

from __future__ import annotations

from typing import NamedTuple

from deepseis_core.constants import CA_LENGTH, L1_HZ

MS_PER_WEEK = 604_800_000
RECALL_S = 60.0
"""Of a satellite that is found again so soon it is known when its signal was sent [s]."""
RECALL_MS = 0.1
"""... if its code lies where it should by then, to so much [ms]."""


class SentTime(NamedTuple):
    """A code period's first sample, its code phase there [chips], when it was sent [ms].

    Examples
    --------
    >>> before = SentTime(0, 0.0, 7_000)
    >>> before.recall(4_000_000, 0.0, 0.0, 4e6), before.recall(4_002_000, 0.0, 0.0, 4e6)
    (8000, -1)
    """

    sample_index: int
    code_phase: float
    transmit_ms: int

    def recall(
        self, sample_index: int, code_phase: float, doppler_hz: float, sample_rate_hz: float
    ) -> int:
        """Return when a later code period was sent [ms of week].

        A constant Doppler of 20 Hz too much is 0.8 chips after a minute; a period is 1023. What
        does not agree to `RECALL_MS`, or comes after `RECALL_S`, is something else; -1.
        """
        elapsed = (sample_index - self.sample_index) / sample_rate_hz
        if not 0.0 <= elapsed <= RECALL_S:
            return -1
        parts = (self.code_phase - code_phase) / CA_LENGTH
        periods = parts + 1e3 * elapsed * (1.0 + doppler_hz / L1_HZ)
        if abs(periods - round(periods)) > RECALL_MS:
            return -1
        return (self.transmit_ms + round(periods)) % MS_PER_WEEK
