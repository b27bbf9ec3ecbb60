"""The same chain in one process, without nodes: for tests, notebooks and theory.

It takes the graph's own description (`deepseis_bringup.graph.GraphConfig`) and gives the values
that the graph publishes, in order of validity. Encoded, they are the graph's bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

from deepseis_bringup.graph import GraphConfig, precise_parameters
from deepseis_bringup.offline_inertial import InertialChain
from deepseis_core.config import check
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.sample_clock import SampleClock, utc_ns_from_iso
from deepseis_core.types import Aiding, IfBlock, Observations, Pvt, PvtStatus
from deepseis_frontend.base_events import BaseReference, utc_of
from deepseis_frontend.base_player import BasePlayer
from deepseis_frontend.if_open import open_source
from deepseis_frontend.nodes.base_open import base_events
from deepseis_pvt.assisted_start import assistance_of
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.observables import ObservablesConfig
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.precise import PreciseConfig
from deepseis_pvt.precise_rtk import BaseConfig
from deepseis_pvt.precise_set import PrecisePositions, precise_positions
from deepseis_pvt.pvt_engine import PvtConfig, PvtEngine
from deepseis_pvt.rtk import RtkConfig
from deepseis_pvt.spp import SppConfig
from deepseis_pvt.still_reference import ReferenceConfig
from deepseis_tracking.acquisition import AcquisitionConfig
from deepseis_tracking.acquisition_engine import AcquisitionEngine, RetryConfig
from deepseis_tracking.acquisition_windows import Forecast, WarmStart
from deepseis_tracking.channel import TrackingConfig
from deepseis_tracking.engine import BlockOutput, SlotConfig, TrackingEngine, check_satellites

Config = TypeVar("Config")
Aider = Callable[[IfBlock], Iterable[Aiding]]
"""Gives the aiding that lets a block be worked through."""

TRACKERS = "trackers"
BESIDE = "beside/"


@dataclass(frozen=True)
class Output:
    """One value on its way: topic, value, UTC of validity as in the message's header [ns]."""

    topic: str
    value: Any
    utc_ns: int


@dataclass(frozen=True)
class _Source:
    """Settings of the source that open a recording."""

    file: str = ""
    format: str = ""
    sample_rate_hz: float = 0.0
    intermediate_frequency_hz: float = 0.0
    start_utc: str = ""
    start_s: float = 0.0
    length_s: float = 0.0


class OfflineChain:
    """Source, acquisition, tracking and PVT of a graph's description.

    Parameters
    ----------
    config : GraphConfig
        As for the graph; files and processes in it do not matter.
    aiding : callable, optional
        Called with every block before it is tracked; returns the aiding that becomes due.

    Attributes
    ----------
    source, acquisition, tracking, pvt
        The parts, to be looked at.
    beside : list of InertialChain
        Other inertial halves on the same inputs, whose aiding nobody takes; what they say comes
        on topics that begin with ``beside/``.

    Raises
    ------
    InputError
        The recording cannot be used.
    """

    def __init__(self, config: GraphConfig, aiding: Aider | None = None) -> None:
        tracker = config.parameters.get("tracker", {})
        searcher = config.parameters.get("acquisition", {})
        chosen = pick(_Source, config.source)
        self.source, self.aiding = open_source(chosen), aiding
        names = check_satellites(list(config.satellites))
        start_ns = utc_ns_from_iso(chosen.start_utc) if chosen.start_utc else 0
        start_ns = start_ns or self.source.start_utc_ns or 0
        self.clock = SampleClock(start_ns, self.source.sample_rate_hz)
        self.acquisition = AcquisitionEngine(
            names,
            pick(AcquisitionConfig, searcher),
            pick(SlotConfig, searcher),
            pick(RetryConfig, searcher),
            Forecast(pick(WarmStart, searcher)),
        )
        self.acquisition.clock = self.clock
        self.acquisition.expect_trackers([TRACKERS])
        self.tracking = TrackingEngine(
            names,
            pick(TrackingConfig, tracker),
            pick(SlotConfig, tracker),
            wait_aiding=aiding is not None or config.aiding == "fusion",
        )
        known = {**precise_parameters(config), **config.parameters.get("pvt", {})}
        self.pvt = _pvt_engine(config, known)
        troposphere = bool(known.get("troposphere", True))
        self.pvt.assist(
            assistance_of(known.get("position_ecef", ()), self.clock, troposphere=troposphere)
        )
        self.precise = _precise(config, known, self.pvt.book)
        self.pvt.witnesses = self.precise.late
        self._base: BasePlayer | None = None
        if config.base:
            events = base_events(config.base_from or chosen.file, self.clock)
            self._base = BasePlayer(events, self.clock)
        self.inertial: InertialChain | None = None
        self.beside: list[InertialChain] = []
        if config.aiding == "fusion":
            self.inertial = self.make_inertial(config)

    def make_inertial(self, config: GraphConfig) -> InertialChain:
        """Return the inertial half of a description, on the clock of this recording."""
        file = config.imu_file or config.source["file"]
        return InertialChain(file, self.clock, config.parameters, pick)

    def _inertials(self) -> list[InertialChain]:
        return [*([self.inertial] if self.inertial is not None else []), *self.beside]

    def run(self) -> Iterator[Output]:
        """Work through the recording; yield what the graph would publish."""
        for block in self.source.blocks():
            utc_ns = self.clock.utc_ns(block.sample_index)
            yield Output("if/samples", block, utc_ns)
            self.acquisition.push_block(block)
            self.tracking.push_block(block)
            for aiding in self.aiding(block) if self.aiding is not None else ():
                first = self.clock.utc_ns(aiding.knot_sample_index)
                yield Output("aiding/doppler", aiding, first)
                self.tracking.push_aiding(aiding)
            last = block.sample_index + block.sample_count - 1
            yield from self._fused(last)
            yield from self._based(last)
            yield from self._search()
            output = self.tracking.advance()
            assert output is not None, f"waits for {self.tracking.waiting_for()}"
            yield from self._tracked(output, utc_ns)
            yield from self._positions()
        yield from self._positions(self.pvt.newest_sample())

    def _fused(self, through: int) -> Iterator[Output]:
        """Work out the inertial half through a sample; its aiding goes to the trackers."""
        if self.inertial is None:
            return
        for topic, value, utc_ns in self.inertial.advance(through):
            yield Output(topic, value, utc_ns)
            if topic == "aiding/doppler":
                self.tracking.push_aiding(value)
            if topic == "motion/state":
                self.precise.push_motion(value)
        self.precise.motion_valid(self.inertial.motion.valid_through)
        for other in self.beside:
            for topic, value, utc_ns in other.advance(through):
                yield Output(f"{BESIDE}{topic}", value, utc_ns)

    def _based(self, through: int) -> Iterator[Output]:
        """Play the base through a sample; then epochs may go as far as their inputs do."""
        for event in self._base.due(through) if self._base is not None else ():
            if isinstance(event, BaseReference):
                yield Output("base/reference", event, utc_of(event))
                self.precise.push_base_place(event.position_ecef, event.utc_ns)
            else:
                yield Output("base/observations", event, utc_of(event))
                self.precise.push_base(event)
        self.precise.base_valid(through)

    def _search(self) -> Iterator[Output]:
        engine = self.acquisition
        while (results := engine.advance()) is not None:
            for result in results:
                utc_ns = self.clock.utc_ns(result.sample_index)
                yield Output("acquisition/result", result, utc_ns)
                self.tracking.push_result(result)
        self.tracking.acquisition_valid(engine.valid_through, engine.result_count)

    def _tracked(self, output: BlockOutput, utc_ns: int) -> Iterator[Output]:
        in_order = sorted(
            output.ephemerides, key=lambda e: (e.effective_sample_index, e.satellite)
        )
        for ephemeris in in_order:
            stamp = self.clock.utc_ns(ephemeris.effective_sample_index)
            yield Output("gnss/ephemeris", ephemeris, stamp)
            self.pvt.push_ephemeris(ephemeris)
            for inertial in self._inertials():
                inertial.push_ephemeris(ephemeris)
        for satellite, sample_index in output.requests:
            stamp = self.clock.utc_ns(sample_index)
            yield Output("acquisition/request", (satellite, sample_index), stamp)
            self.acquisition.push_request(satellite, sample_index, TRACKERS)
        for epochs in output.epochs:
            yield Output(f"tracking/{epochs.satellite}/epochs", epochs, utc_ns)
            self.pvt.push_epochs(epochs)
        block, engine = output.block, self.tracking
        last = block.sample_index + block.sample_count - 1
        self.acquisition.tracker_valid(TRACKERS, last, engine.request_count)

    def _positions(self, force_through: int | None = None) -> Iterator[Output]:
        for epoch in self.pvt.steps(force_through):
            if epoch is None:
                continue
            observations, pvt = epoch
            for output in _solved(self.clock, observations, pvt, self.precise, self.pvt.missed):
                yield output
                for inertial in self._inertials():
                    inertial.push_position(output.topic, output.value)
        for inertial in self._inertials():
            inertial.pvt_valid(self.pvt.valid_through)


def _solved(
    clock: SampleClock,
    observations: Observations,
    pvt: Pvt | None,
    precise: PrecisePositions,
    missed: Mapping[str, int],
) -> Iterator[Output]:
    utc_ns = _utc_ns(observations)
    yield Output("gnss/observations", observations, utc_ns)
    if pvt is not None:
        yield Output("gnss/pvt", pvt, utc_ns)
        yield Output("gnss/fix", pvt, utc_ns)
        if pvt.status != PvtStatus.NONE:
            yield Output("gnss/time_reference", (observations, pvt, clock), utc_ns)
    for topic, value in precise.solve(observations, missed):
        yield Output(topic, value, utc_ns)


def _utc_ns(observations: Observations) -> int:
    return GpsTime(observations.week, observations.tow_ns).to_utc_ns()


def _precise(config: GraphConfig, given: Any, book: EphemerisBook) -> PrecisePositions:
    return precise_positions(
        given.get("position_ecef", ()),
        book,
        config.sample_rate_hz,
        pick(PreciseConfig, given),
        pick(PhaseConfig, given),
        pick(ReferenceConfig, given),
        pick(SppConfig, given),
        pick(RtkConfig, given),
        pick(BaseConfig, given),
    )


def _pvt_engine(config: GraphConfig, given: Any) -> PvtEngine:
    engine = PvtEngine(
        pick(PvtConfig, given),
        config.sample_rate_hz,
        config.satellites,
        observables=pick(ObservablesConfig, given),
        spp=pick(SppConfig, given),
    )
    if given.get("nav_file"):
        file = read_rinex_nav(given["nav_file"])
        for ephemeris in file.ephemerides:
            engine.push_ephemeris(ephemeris)
        if file.iono_alpha:
            engine.push_klobuchar(file.iono_alpha, file.iono_beta)
    return engine


def pick(config_type: type[Config], given: Any) -> Config:
    """Fill a settings dataclass with those of the given parameters that are its own."""
    names = {item.name for item in fields(config_type)}  # type: ignore[arg-type]
    config = config_type(**{name: value for name, value in given.items() if name in names})
    check(config)
    return config


def encode(output: Output) -> bytes:
    """Return the bytes that the graph publishes for an output."""
    from deepseis_core.imu_message import encode_imu
    from deepseis_core.ros import codecs
    from deepseis_core.ros.cdr import Codec, encode_message
    from deepseis_core.ros.navsat import fix_from_pvt, time_reference

    topic, value, utc_ns = output.topic, output.value, output.utc_ns
    if topic == "gnss/fix":
        return encode_message(fix_from_pvt(value, utc_ns))
    if topic == "gnss/time_reference":
        observations, pvt, clock = value
        return encode_message(time_reference(observations, pvt, clock, utc_ns))
    if topic == "base/reference":
        return codecs.STATION.encode(value.station(), utc_ns)
    if topic == "imu/data_raw":
        return encode_imu(value, utc_ns)
    if topic == "ins/solution":
        return codecs.INS_SOLUTION.encode(value, utc_ns, "map")
    if topic == "seismo/displacement":
        return codecs.DISPLACEMENT.encode(value, utc_ns, "map")
    if topic == "acquisition/request":
        satellite, sample_index, *_ = value
        return encode_message(codecs.acquisition_request(satellite, sample_index, utc_ns))
    by_topic: dict[str, Codec[Any]] = {
        "if/samples": codecs.IF_BLOCK,
        "acquisition/result": codecs.ACQUISITION_RESULT,
        "gnss/ephemeris": codecs.EPHEMERIS,
        "gnss/observations": codecs.OBSERVATIONS,
        "gnss/pvt": codecs.PVT,
        "gnss/precise": codecs.PRECISE_POSITION,
        "gnss/rtk": codecs.PRECISE_POSITION,
        "base/observations": codecs.OBSERVATIONS,
        "ldv/velocity": codecs.LDV_VELOCITY,
        "aiding/doppler": codecs.DOPPLER_AIDING,
        "motion/state": codecs.MOTION_STATE,
        "seismo/event": codecs.SEISMIC_EVENT,
    }
    return by_topic.get(topic, codecs.TRACKING_EPOCHS).encode(value, utc_ns)
