"""What the bench puts out, stream by stream, as the values of the topics.

Every stream gives its values for any span of samples, in order; how a run is cut into spans
changes nothing. A value belongs to the span that holds its time of validity.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from deepseis_core.constants import NS_PER_S, SPEED_OF_LIGHT
from deepseis_core.gps_time import GpsTime
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import (
    FloatArray,
    IfBlock,
    ImuSample,
    IntArray,
    LdvVelocity,
    Observations,
    Pvt,
    PvtStatus,
    Truth,
)
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.ldv import LdvSynthesizer
from deepseis_sim.motion import Motion
from deepseis_sim.position_errors import PositionErrorConfig, PositionErrors
from deepseis_sim.recording import FrontEnd, IfStream, truth_rows
from deepseis_sim.signal_model import SignalModel
from deepseis_sim.site import Site, orientation_xyzw
from deepseis_sim.sky import Sky

SATELLITE_TRUTH_HZ: Final = 100
"""Epochs of satellites' truth a second."""
ABSENT: Final = -1.0
"""Variance of what the IMU does not have."""


class Item(NamedTuple):
    """A value for a topic, valid ``offset_ns`` after sample 0.

    ``stamp_ns`` is the moment that it is about, if that is another.
    """

    offset_ns: int
    topic: str
    value: Any
    stamp_ns: int | None = None


class Stream(Protocol):
    """One topic's values."""

    def between(self, begin: int, end: int) -> Iterator[Item]:
        """Yield the values valid from sample ``begin`` up to, not including, sample ``end``."""


class Ticks:
    """A regular series of moments on the sample clock, exact for ever.

    Parameters
    ----------
    rate_hz : float
        Of the series, resolved to 1 mHz.
    sample_rate_hz : float
        Of the clock.
    """

    def __init__(self, rate_hz: float, sample_rate_hz: float) -> None:
        self.rate_mhz, self.sample_mhz = round(rate_hz * 1e3), round(sample_rate_hz * 1e3)

    def between(self, begin: int, end: int) -> range:
        """Return the numbers of the moments from sample ``begin`` up to ``end``."""
        first, last = (-(-n * self.rate_mhz // self.sample_mhz) for n in (begin, end))
        return range(first, last)

    def sample_index(self, number: int) -> int:
        """Return the last whole sample at or before a moment."""
        return number * self.sample_mhz // self.rate_mhz

    def offset_ns(self, number: int) -> int:
        """Return a moment's time since sample 0 [ns]."""
        return number * 1000 * NS_PER_S // self.rate_mhz

    def samples(self, numbers: range) -> IntArray:
        """Return `sample_index` of many moments."""
        return np.array([self.sample_index(number) for number in numbers], np.int64)

    def times(self, numbers: range) -> FloatArray:
        """Return the moments' times since sample 0 [s]."""
        return np.arange(numbers.start, numbers.stop) / (self.rate_mhz / 1e3)


class TruthStream:
    """Motion of the antenna and what every satellite's signal does, in batches."""

    def __init__(
        self,
        model: SignalModel,
        sky: Sky,
        site: Site,
        motion: Motion,
        lever_arm_b: FloatArray,
        rates: tuple[float, float],
    ) -> None:
        rate_hz, sample_rate_hz = rates
        self.model, self.sky = model, sky
        self.site, self.motion, self.lever_arm_b = site, motion, lever_arm_b
        self.sample_rate_hz = sample_rate_hz
        self.ticks = Ticks(rate_hz, sample_rate_hz)
        self.satellite_ticks = Ticks(SATELLITE_TRUTH_HZ, sample_rate_hz)
        self._attitude: FloatArray | None = None  # the last one: signs go on from it

    def value(self, begin: int, end: int) -> Truth:
        """Return the truth of a span of samples, at the samples that its indices name."""
        indices = self.ticks.samples(self.ticks.between(begin, end))
        time = indices / self.sample_rate_hz
        true_time = time - self.model.clock(time)
        states = self.site.states(self.motion, true_time, self.lever_arm_b)
        attitude = orientation_xyzw(self.motion.at(true_time), self._attitude)
        attitude = np.broadcast_to(attitude, (len(time), 4))
        self._attitude = attitude[-1] if len(time) else self._attitude
        satellite_indices = self.satellite_ticks.samples(self.satellite_ticks.between(begin, end))
        satellite_time = satellite_indices / self.sample_rate_hz
        rows = truth_rows(self.model, satellite_time)
        return Truth(
            end - 1,
            indices,
            states.position,
            states.velocity,
            states.acceleration,
            attitude,
            satellite_indices,
            tuple(item.satellite for item in self.model.satellites),
            rows["range"],
            rows["pseudorange"],
            rows["carrier_phase_cycles"],
            rows["carrier_doppler_hz"],
            self.sky.cn0_dbhz(satellite_time).astype(np.float32),
            rows["clock_bias"],
        )

    def between(self, begin: int, end: int) -> Iterator[Item]:
        """Yield one batch."""
        yield Item(_offset_ns(begin, self.sample_rate_hz), "truth", self.value(begin, end))


class IfBlocks:
    """The samples, in blocks; ``begin`` lies between blocks."""

    def __init__(self, stream: IfStream, front_end: FrontEnd, samples_per_block: int) -> None:
        self.stream, self.front_end = stream, front_end
        self.samples_per_block = samples_per_block

    def between(self, begin: int, end: int) -> Iterator[Item]:
        """Yield the blocks, the last one cut short where the run ends."""
        packing, rate = self.front_end.format, self.front_end.sample_rate_hz
        synthesizer = self.stream.synthesizer
        first, last = begin // synthesizer.segment_samples, -(-end // synthesizer.segment_samples)
        segments = self.stream.segments(first, last - first)
        data = synthesizer.packed(segments, begin, end - begin)
        for start in range(begin, end, self.samples_per_block):
            count = min(self.samples_per_block, end - start)
            first = packing.bytes_for(start - begin)
            block = IfBlock(
                start,
                count,
                rate,
                self.front_end.intermediate_frequency_hz,
                packing.to_text(),
                data[first : first + packing.bytes_for(count)],
            )
            yield Item(_offset_ns(start, rate), "if/samples", block)


class ImuStream:
    """Samples of the inertial measurement unit, each valid at the end of its interval."""

    def __init__(
        self,
        synthesizer: ImuSynthesizer,
        errors: ImuErrors,
        grade: ImuGrade,
        rates: tuple[float, float],
    ) -> None:
        self.synthesizer, self.errors = synthesizer, errors
        self.ticks, self.rate_hz = Ticks(*rates), rates[0]
        walks = grade.gyros.walk, grade.accelerometers.walk
        variances = [walk**2 * self.rate_hz for walk in walks]
        self.variances = (variances[0] if grade.has_gyros else ABSENT, variances[1])

    def between(self, begin: int, end: int) -> Iterator[Item]:
        """Yield the samples whose intervals end there."""
        numbers = self.ticks.between(begin, end)
        first, count = max(numbers.start, 1), numbers.stop - max(numbers.start, 1)
        if count <= 0:
            return
        made = self.synthesizer.increments(first - 1, count)
        measured = self.errors.apply(first - 1, made.delta_theta, made.delta_vel)
        angular = np.nan_to_num(measured.delta_theta) * self.rate_hz
        linear = measured.delta_vel * self.rate_hz
        for k in range(count):
            index = self.ticks.sample_index(first + k)
            sample = ImuSample(index, angular[k], linear[k], *self.variances)
            yield Item(self.ticks.offset_ns(first + k), "imu/data_raw", sample)


class Epochs(Protocol):
    """A receiver's observations by number."""

    def epochs(self, first: int, count: int) -> Iterator[Observations]:
        """Yield epochs ``first .. first + count``."""


class ObservationStream:
    """Observations of a receiver; spans must follow one another."""

    def __init__(self, topic: str, receiver: Epochs, start: GpsTime, sample_rate_hz: float):
        self.topic, self.receiver = topic, receiver
        self.start, self.sample_rate_hz = start, sample_rate_hz
        self._number = 0
        self._next = self._make()

    def _make(self) -> Observations:
        (made,) = self.receiver.epochs(self._number, 1)
        self._number += 1
        return made

    def between(self, begin: int, end: int) -> Iterator[Item]:
        """Yield the epochs of the span."""
        limit = _offset_ns(end, self.sample_rate_hz)
        while True:
            epoch = self._next
            offset = GpsTime(epoch.week, epoch.tow_ns).diff_ns(self.start)
            if offset >= limit:
                return
            yield Item(offset, self.topic, epoch)
            self._next = self._make()


class LdvStream:
    """The velocimeter's measurements."""

    def __init__(self, synthesizer: LdvSynthesizer, sample_rate_hz: float) -> None:
        self.synthesizer = synthesizer
        self.ticks = Ticks(synthesizer.config.rate_hz, sample_rate_hz)

    def between(self, begin: int, end: int) -> Iterator[Item]:
        """Yield the measurements of the span."""
        numbers = self.ticks.between(begin, end)
        first, count = max(numbers.start, 1), numbers.stop - max(numbers.start, 1)
        if count <= 0:
            return
        made = self.synthesizer.chunk(first - 1, count)
        for k, number in enumerate(range(first, numbers.stop)):
            ends = self.ticks.offset_ns(number)
            middle = (self.ticks.offset_ns(number - 1) + ends) // 2
            value = LdvVelocity(
                middle * self.ticks.sample_mhz // (1000 * NS_PER_S),
                self.ticks.sample_index(number),
                made.beam_velocity[k],
                made.beam_elevation,
                float(made.forward_velocity[k]),
                float(made.vertical_velocity[k]),
                made.beam_velocity_sd[k].astype(np.float32),
                float(made.quality[k]),
            )
            yield Item(ends, "ldv/velocity", value, middle)


class PositionStream:
    """Positions of a precise point positioning, with the errors that its users know of."""

    def __init__(
        self,
        config: PositionErrorConfig,
        model: SignalModel,
        site: Site,
        rates: tuple[float, float],
        seed: int,
    ) -> None:
        self.errors, self.model = PositionErrors(config, rates[0], seed), model
        self.C_e_enu, self.ticks = site.C_e_enu, Ticks(*rates)
        variance = np.square(config.white_sd) + np.square(config.drift_sd)
        self.covariance = self.C_e_enu @ np.diag(variance) @ self.C_e_enu.T

    def between(self, begin: int, end: int) -> Iterator[Item]:
        """Yield the positions of the span."""
        numbers = self.ticks.between(begin, end)
        if not numbers:
            return
        time = self.ticks.times(numbers)
        bias = self.model.clock(time)
        errors = self.errors(numbers.start, len(numbers)) @ self.C_e_enu.T
        measured = self.model.antenna(time - bias) + errors
        unknown = np.full(3, np.nan)
        for k, number in enumerate(numbers):
            offset, index = self.ticks.offset_ns(number), self.ticks.sample_index(number)
            when = self.model.start.add_ns(offset)
            value = Pvt(
                sample_index=index,
                week=when.week,
                tow_ns=when.tow_ns,
                valid_through=index,
                status=PvtStatus.FIX,
                position_ecef=measured[k],
                velocity_ecef=unknown,
                clock_bias=SPEED_OF_LIGHT * float(bias[k]),
                clock_drift=float("nan"),
                position_covariance_ecef=self.covariance,
                velocity_covariance_ecef=np.full((3, 3), np.nan),
            )
            yield Item(offset, "gnss/pvt", value)


def _offset_ns(sample_index: int, sample_rate_hz: float) -> int:
    return sample_index * 1000 * NS_PER_S // round(sample_rate_hz * 1e3)
