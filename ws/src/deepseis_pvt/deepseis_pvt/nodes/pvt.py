"""Node: observables on the GPS-time grid, position, RINEX."""

from __future__ import annotations

import time
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import NavSatFix, TimeReference

from deepseis_core.config import setting
from deepseis_core.counted import CountedInput
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.gps_time import GpsTime
from deepseis_core.latency import Arrivals
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.cdr import encode_message
from deepseis_core.ros.codecs import subscribe
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.navsat import fix_from_pvt, time_reference
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.realtime import RealtimeReport
from deepseis_core.ros.steady import every
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Ephemeris, MotionState, PvtStatus, Station, TrackingEpochs
from deepseis_core.types import Observations as ObservationsValue
from deepseis_core.types import Pvt as PvtValue
from deepseis_msgs.msg import Observations, PrecisePosition, Pvt, Watermark
from deepseis_pvt.assisted_start import assistance_of
from deepseis_pvt.epoch_deadline import EpochDeadline
from deepseis_pvt.observables import ObservablesConfig
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.precise import PreciseConfig
from deepseis_pvt.precise_rtk import BaseConfig
from deepseis_pvt.precise_set import PHASE_TOPIC, RTK_TOPIC, precise_positions
from deepseis_pvt.products import RinexProducts
from deepseis_pvt.pvt_engine import PvtConfig, PvtEngine
from deepseis_pvt.rehearsal import rehearse
from deepseis_pvt.rinex_obs import RinexStation
from deepseis_pvt.rtk import RtkConfig
from deepseis_pvt.spp import SppConfig
from deepseis_pvt.still_reference import ReferenceConfig

MOTION, BASE = "motion_state", "base_source"


@dataclass(frozen=True)
class NodeConfig:
    """The node's place in the graph, and its files."""

    satellites: list[str] = setting([], "satellites whose trackers exist [-]")
    trackers: list[str] = setting([], "flow members that run the trackers [-]")
    sample_rate_hz: float = setting(4e6, "IF sampling rate [Hz]", low=1e5)
    nav_file: str = setting("", "RINEX navigation file for an assisted start; empty: none [path]")
    position_ecef: list[float] = setting(
        [], "surveyed antenna for an assisted start, ECEF; empty: not known [m]"
    )
    output_dir: str = setting("", "folder for RINEX; empty: none [path]")
    station_name: str = setting("DSEI00XXX", "nine characters of the RINEX names [-]")
    pvt_deadline_ms: float = setting(200.0, "realtime: wait so long for inputs [ms]", low=0)


class PvtNode(Node):
    """In: tracking/<sat>/epochs, gnss/ephemeris, motion/state, base/observations, base/reference.

    Out: gnss/observations, gnss/pvt, gnss/fix, gnss/time_reference, gnss/precise, gnss/rtk.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("pvt")
        self.process = process
        self.flow = Flow(self, process, "pvt", declare(self, FlowConfig))
        self.config, engine_config = declare(self, NodeConfig), declare(self, PvtConfig)
        observables, spp = declare(self, ObservablesConfig), declare(self, SppConfig)
        precise, phase = declare(self, PreciseConfig), declare(self, PhaseConfig)
        reference = declare(self, ReferenceConfig)
        rtk, base = declare(self, RtkConfig), declare(self, BaseConfig)
        reject_unknown(self)
        config, self.troposphere = self.config, spp.troposphere
        try:
            self.engine = PvtEngine(
                engine_config,
                config.sample_rate_hz,
                config.satellites,
                observables=observables,
                spp=spp,
                script=self.flow.script,
            )
        except ValueError as error:
            raise InputError("parameters of pvt", str(error)) from None
        self.products: RinexProducts | None = None
        if config.output_dir:
            station = RinexStation(name=config.station_name)
            self.products = RinexProducts(
                config.output_dir, station, patient=not self.flow.lockstep
            )
        parts = precise, phase, reference, spp, rtk, base
        self.precise = precise_positions(
            config.position_ecef, self.engine.book, config.sample_rate_hz, *parts
        )
        self.engine.witnesses = self.precise.late
        if not self.flow.lockstep:
            rehearse(config.sample_rate_hz, observables, *parts)
        followed = [*([MOTION] * precise.wait_motion), *([BASE] * precise.wait_base)]
        self.witnesses = {name: CountedInput(counting=not self.flow.rejoins) for name in followed}
        self.members = [*config.trackers, *followed]
        # At the end of the stream, in lockstep: what a tracker has said may be overtaken.
        counting = self.flow.lockstep
        self.spoken = {name: CountedInput(counting=counting) for name in config.trackers}
        self.load_navigation()
        self.clock: SampleClock | None = None
        self.positions = self.ephemerides = self.precise_positions = self.epochs = 0
        self.second = -1
        self.deadline, self.arrivals = EpochDeadline(1e-3 * config.pvt_deadline_ms), Arrivals()
        self.is_placed = self.ending = False
        self.advertise()
        self.listen()

    def advertise(self) -> None:
        """Create the publishers."""
        publish_on = self.flow.publish_on
        self.observations = publish_on("gnss/observations", Observations, qos.STREAM)
        self.pvt = publish_on("gnss/pvt", Pvt, qos.STREAM)
        self.fix = publish_on("gnss/fix", NavSatFix, qos.STREAM)
        self.time = publish_on("gnss/time_reference", TimeReference, qos.STREAM)
        self.displacement = {PHASE_TOPIC: publish_on(PHASE_TOPIC, PrecisePosition, qos.STREAM)}
        if BASE in self.witnesses:
            self.displacement[RTK_TOPIC] = publish_on(RTK_TOPIC, PrecisePosition, qos.STREAM)
        self.diagnostics = publish_on("/diagnostics", DiagnosticArray, qos.STREAM)

    def listen(self) -> None:
        """Subscribe to the inputs and to how far others are."""
        for satellite in self.config.satellites:
            topic = f"tracking/{satellite}/epochs"
            subscribe(self, codecs.TRACKING_EPOCHS, topic, self.on_epochs, qos.STREAM)
        subscribe(self, codecs.EPHEMERIS, "gnss/ephemeris", self.on_ephemeris, qos.LATCHED)
        if MOTION in self.witnesses:
            subscribe(self, codecs.MOTION_STATE, "motion/state", self.on_motion, qos.LATCHED)
        if BASE in self.witnesses:
            subscribe(self, codecs.OBSERVATIONS, "base/observations", self.on_base, qos.STREAM)
            subscribe(self, codecs.STATION, "base/reference", self.on_base_place, qos.LATCHED)
        self.flow.follow(self.members, self.on_watermark)
        self.realtime: RealtimeReport | None = None
        if not self.flow.lockstep:
            meters = {"samples_to_epoch": "from samples to their epoch"}
            deadline_ms = self.config.pvt_deadline_ms
            self.realtime = RealtimeReport(self, "pvt", meters, deadline_ms)
            self.flow.follow(["if_source"], self.on_source)
            every(self, 0.01, self.on_deadline)

    def load_navigation(self) -> None:
        """Preload ephemerides."""
        if not self.config.nav_file:
            return
        file = read_rinex_nav(self.config.nav_file)
        for ephemeris in file.ephemerides:
            self.engine.push_ephemeris(ephemeris)
        if file.iono_alpha:
            self.engine.push_klobuchar(file.iono_alpha, file.iono_beta)

    def on_epochs(self, epochs: TrackingEpochs, utc_ns: int) -> None:
        """Queue the integrations."""
        if not self.flow.admits(epochs.block_sample_index):
            return
        if self.flow.entry >= 0 and self.clock is None:
            self.engine.join(self.flow.entry)
        if self.clock is None:
            rate = self.config.sample_rate_hz
            self.clock = SampleClock.from_sample(epochs.block_sample_index, utc_ns, rate)
            known = self.config.position_ecef
            self.engine.assist(assistance_of(known, self.clock, troposphere=self.troposphere))
        self.deadline.heard(epochs.satellite)
        self.engine.push_epochs(epochs)
        if (tracker := self.tracker_of(epochs.satellite)) is not None:
            tracker.received()
        self.work()
        self.finish_if_ended()

    def tracker_of(self, satellite: str) -> CountedInput | None:
        """Return what counts the messages of the process that tracks a satellite."""
        own = self.spoken.get(f"trackers_{satellite.lower()}")
        return own or next(iter(self.spoken.values()), None)

    def on_ephemeris(self, ephemeris: Ephemeris, _utc_ns: int) -> None:
        """Take an ephemeris that was decoded."""
        self.engine.push_ephemeris(ephemeris)
        self.ephemerides += 1
        if self.products is not None:
            self.products.add(ephemeris)
        self.work()

    def on_motion(self, state: MotionState, _utc_ns: int) -> None:
        """Take a decision on motion."""
        self.precise.push_motion(state)
        self.witnesses[MOTION].received()
        self.work()
        self.finish_if_ended()

    def on_base(self, observations: ObservationsValue, _utc_ns: int) -> None:
        """Take an epoch of the base."""
        self.precise.push_base(observations)
        self.witnesses[BASE].received()
        self.work()
        self.finish_if_ended()

    def on_base_place(self, station: Station, utc_ns: int) -> None:
        """Take where the base is."""
        place = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
        self.precise.push_base_place(place, utc_ns)
        self.witnesses[BASE].received()
        self.work()
        self.finish_if_ended()

    def on_watermark(self, msg: Watermark) -> None:
        """Take how far motion and base are valid, and look whether the stream has ended."""
        if msg.node in self.witnesses:
            self.witnesses[msg.node].announced(msg.event_count, msg.valid_through)
            self.work()
        if msg.node in self.spoken:
            self.spoken[msg.node].announced(msg.observation_count, msg.valid_through)
        self.finish_if_ended()

    def finish_if_ended(self) -> None:
        """Work through what is left once all inputs have ended and arrived."""
        others = self.flow.others
        ended = all(n in others and others[n].end_of_stream for n in self.members)
        if not (ended and self.members) or self.flow.ended:
            return
        counted = {**self.witnesses, **self.spoken}
        if any(w.valid_through < others[n].valid_through for n, w in counted.items()):
            return
        self.ending = True
        self.work(self.engine.newest_sample())
        if self.realtime is not None and self.clock is not None:
            self.realtime.finish(self.clock.utc_ns(self.engine.worked_through))
        self.flow.finish()

    def on_source(self, msg: Watermark) -> None:
        """Realtime: note how far samples have come."""
        self.deadline.arrived(msg.valid_through)
        self.arrivals.note(msg.valid_through, time.monotonic())

    def on_deadline(self) -> None:
        """Realtime: wait no longer than the deadline for what belongs to samples that are there.

        While all satellites wait for the first search there is nothing to be late with.
        """
        self.deadline.look()
        if self.clock is None or self.engine.newest_sample() < 0:
            return
        self.work()
        engine, sample = self.engine, self.engine.valid_through + 1
        while self.deadline.is_overdue(sample, engine.late(sample), engine.newest_sample()):
            self.work(sample)
            sample = engine.valid_through + 1

    def work(self, force_through: int | None = None) -> None:
        """Work through all epochs that the watermarks allow and publish, the watermark last."""
        before = self.engine.worked_through
        if MOTION in self.witnesses:
            self.precise.motion_valid(self.witnesses[MOTION].valid_through)
        if BASE in self.witnesses:
            self.precise.base_valid(self.witnesses[BASE].valid_through)
        for epoch in self.engine.steps(force_through):
            self.note()
            if epoch is not None:
                self.publish(*epoch)
            self.report_each_second()
        worked = self.engine.worked_through
        if worked == before or self.clock is None:
            return
        self.flow.send(
            self.engine.valid_through,
            worked,
            event_count=self.positions,
            ephemeris_count=self.ephemerides,
            precise_count=self.precise_positions,
            observation_count=self.epochs,
            utc_ns=self.clock.utc_ns(worked),
        )

    def note(self) -> None:
        """Real time: note what an epoch lacked, and how long ago its samples came."""
        if self.realtime is None:
            return
        worked = self.engine.worked_through
        # What is lacking after the end of the stream is no miss: in lockstep it lacks too.
        for what, through in self.engine.missed.items() if not self.ending else ():
            count = self.engine.valid_through + 1 - worked
            self.realtime.misses.note(what, worked, count, through)
        came = self.arrivals.of(worked)
        if came is not None:
            self.realtime.meters["samples_to_epoch"].add(time.monotonic() - came)

    def publish(self, observations: ObservationsValue, pvt: PvtValue | None) -> None:
        """Publish one epoch."""
        utc_ns = GpsTime(observations.week, observations.tow_ns).to_utc_ns()
        self.epochs += 1
        self.observations.publish(codecs.OBSERVATIONS.encode(observations, utc_ns))
        if pvt is not None:
            self.positions += 1
            self.is_placed = pvt.status != PvtStatus.NONE
            self.pvt.publish(codecs.PVT.encode(pvt, utc_ns))
            self.fix.publish(encode_message(fix_from_pvt(pvt, utc_ns)))
            if self.is_placed and self.clock is not None:
                told = time_reference(observations, pvt, self.clock, utc_ns)
                self.time.publish(encode_message(told))
        for topic, value in self.precise.solve(observations, self.engine.missed):
            self.precise_positions += topic == PHASE_TOPIC
            if topic in self.displacement:
                self.displacement[topic].publish(codecs.PRECISE_POSITION.encode(value, utc_ns))
        if self.products is not None:
            self.products.write(observations, pvt)

    def report_each_second(self) -> None:
        """Publish the counters at the first step of every second of samples."""
        worked, clock = self.engine.worked_through, self.clock
        if clock is not None and worked >= (self.second + 1) * clock.sample_rate_hz:
            self.second = int(worked / clock.sample_rate_hz)
            self.report(clock.utc_ns(worked))

    def report(self, utc_ns: int) -> None:
        """Publish the counters."""
        counts = self.engine.statistics
        counts |= self.precise.statistics
        text = f"{counts['positions']} positions" if self.engine.clock else "no fix yet"
        if self.engine.clock and not self.is_placed:
            text = f"no position now, {text} so far"
        is_well = self.is_placed and not counts["forced"]
        level = diagnostics.OK if is_well else diagnostics.WARN
        if self.precise.base_trouble:
            level, text = diagnostics.WARN, f"{text}; {self.precise.base_trouble}"
        if self.products is not None and self.products.lost:
            counts["rinex_epochs_lost"], level = self.products.lost, diagnostics.WARN
        self.diagnostics.publish(diagnostics.encoded("pvt", level, text, counts, utc_ns))
        if self.realtime is not None:
            self.realtime.publish(utc_ns)

    def close(self) -> None:
        """Finish the files."""
        if self.products is not None:
            for path in self.products.close():
                self.get_logger().info(f"wrote {path}")


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(PvtNode(process)), "pvt")


if __name__ == "__main__":
    main()
