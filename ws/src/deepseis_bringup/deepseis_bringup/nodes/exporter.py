"""Node: a live station's data in the formats of others: archive, ringserver, RTCM, NMEA."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from deepseis_bringup.export.datalink import DataLink, address_of
from deepseis_bringup.export.gdrt import GdrtSender
from deepseis_bringup.export.live_export import LiveConfig, LiveExport
from deepseis_bringup.export.nmea import gga
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.export.rtcm_stream import RtcmConfig, RtcmStream
from deepseis_bringup.export.sds import SdsArchive
from deepseis_bringup.export.tcp_out import TcpOut
from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.imu_message import decode_imu
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.codecs import subscribe
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.steady import every
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    Ephemeris,
    Observations,
    PrecisePosition,
    Pvt,
    Station,
)
from deepseis_ins.ground_motion import PreciseMotion
from deepseis_msgs.msg import InsSolution

_BY_STAMP = SampleClock(0, 1e9)

DEEP = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
"""Nobody waits for the exporter: a busy machine or disk may hold it up for a minute."""


@dataclass(frozen=True)
class ExporterConfig:
    """Where the records go."""

    directory: str = setting("", "root of the SDS archive, made if need be [path]")
    datalink: str = setting("", "ringserver's DataLink as host:port; empty: none [-]")
    gdrt: str = setting("", "SeisComP's gdrt_plugin as host:port, UDP; empty: none [-]")
    gdrt_source: str = setting(
        "fused", "motion sent there [-]", choices=("gnss", "aided", "fused")
    )
    rtcm: str = setting("", "RTCM 3 for whoever connects to host:port; empty: none [-]")
    nmea: str = setting("", "GGA for whoever connects to host:port; empty: none [-]")


class ExporterNode(Node):
    """In: station, gnss/pvt, ins/solution, seismo/displacement, imu/data_raw. Out: /diagnostics.

    Of a station without a fusion the displacement by phases alone, gnss/precise.
    For RTCM gnss/observations and gnss/ephemeris too. Takes no part in the graph's flow control:
    it may come, go and fail. Parameters: ExporterConfig, LiveConfig, RtcmConfig.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("exporter")
        self.config, live = declare(self, ExporterConfig), declare(self, LiveConfig)
        rtcm = declare(self, RtcmConfig)
        reject_unknown(self)
        if not self.config.directory:
            raise InputError("parameter directory of exporter", "is empty", "name the archive")
        obspy_modules()  # takes a second: before messages come, not when the first is written
        self.folder = Path(self.config.directory)
        self.archive = SdsArchive(self.folder)
        self.link: DataLink | None = None
        if self.config.datalink:
            self.link = DataLink(*address_of(self.config.datalink), self.get_logger().info)
        gdrt = self.config.gdrt
        self.gdrt_address = address_of(gdrt, None) if gdrt else None
        self.gdrt: GdrtSender | None = None
        self.export = LiveExport(live, None, self.put)
        subscribe(self, codecs.STATION, "station", self.on_station, qos.LATCHED)
        subscribe(self, codecs.PVT, "gnss/pvt", self.on_pvt, DEEP)
        self.create_subscription(InsSolution, "ins/solution", self.on_solution, DEEP, raw=True)
        subscribe(self, codecs.DISPLACEMENT, "seismo/displacement", self.on_motion, DEEP)
        self.precise, self.is_fused = PreciseMotion(), True
        subscribe(self, codecs.PRECISE_POSITION, "gnss/precise", self.on_precise, DEEP)
        self.create_subscription(Imu, "imu/data_raw", self.on_imu, DEEP, raw=True)
        self.serve(rtcm)
        diagnostics.of_station(self.get_namespace())
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.STREAM)
        every(self, 1.0, self.report)

    def serve(self, config: RtcmConfig) -> None:
        """Open the ports for receivers."""
        self.rtcm = RtcmStream(config)
        self.servers: dict[str, TcpOut] = {}
        for name, greeting in (("rtcm", self.rtcm.greeting), ("nmea", bytes)):
            if address := getattr(self.config, name):
                place = address_of(address, None)
                self.servers[name] = TcpOut(place, f"parameter {name} of exporter", greeting)
        if "rtcm" in self.servers:
            subscribe(self, codecs.OBSERVATIONS, "gnss/observations", self.on_epoch, DEEP)
            subscribe(self, codecs.EPHEMERIS, "gnss/ephemeris", self.on_ephemeris, qos.LATCHED)

    def put(self, name: Path, records: bytes) -> None:
        """Hand records on; the archive first."""
        self.archive.append(name, records)
        if self.link is not None:
            self.link.put(name, records)

    def on_station(self, station: Station, _utc_ns: int) -> None:
        """Learn the codes."""
        self.export.take_station(station)
        self.rtcm.take_station(station)
        if self.gdrt_address is not None and self.gdrt is None and self.export.place is not None:
            self.gdrt = GdrtSender(
                self.gdrt_address,
                f"{self.export.place.station[:4]:X<4}",
                station.monument_ecef,
                self.get_logger().warning,
                DisplacementSource[self.config.gdrt_source.upper()],
            )
            self.export.on_motion = self.gdrt.take

    def on_pvt(self, pvt: Pvt, _utc_ns: int) -> None:
        """Learn the clock's error."""
        self.export.take_pvt(pvt)
        if "nmea" in self.servers:
            self.servers["nmea"].put(gga(pvt).encode("ascii"))
        if self.gdrt is not None:
            self.gdrt.satellites = len(pvt.satellites)

    def on_epoch(self, observations: Observations, _utc_ns: int) -> None:
        """Send an epoch to receivers."""
        self.servers["rtcm"].put(self.rtcm.take_observations(observations))

    def on_ephemeris(self, ephemeris: Ephemeris, _utc_ns: int) -> None:
        """Send an orbit to receivers."""
        self.servers["rtcm"].put(self.rtcm.take_ephemeris(ephemeris))

    def on_solution(self, data: bytes) -> None:
        """Learn the coarse clock from the first sample's stamp, once."""
        if self.export.knows_coarse_clock:
            return
        solution, utc_ns = codecs.INS_SOLUTION.decode(data)
        if len(solution.sample_index):
            self.export.take_stamp(int(solution.sample_index[0]), utc_ns)

    def on_motion(self, motion: Displacement, _utc_ns: int) -> None:
        """Export ground motion."""
        self.is_fused = True
        self.export.take_displacement(motion)

    def on_precise(self, position: PrecisePosition, _utc_ns: int) -> None:
        """Export the motion that phases show, where nobody else says it."""
        shown = self.precise.take(position, position.sample_index)
        for motion in () if self.is_fused else shown:
            self.export.take_displacement(motion)

    def on_imu(self, data: bytes) -> None:
        """Export an IMU sample."""
        self.export.take_imu(*decode_imu(data, _BY_STAMP))

    def report(self) -> None:
        """Describe new channels; publish the counters."""
        self.is_fused = self.count_publishers("seismo/displacement") > 0
        self.export.describe(self.folder)
        gaps = self.export.series.gaps()
        values = {"records": self.export.records, "held": self.export.held, **vars(gaps)}
        level = diagnostics.OK if self.export.records else diagnostics.WARN
        text = f"{self.export.records} records" if self.export.records else "nothing to export yet"
        if self.link is not None:
            values |= {"sent": self.link.sent, "dropped": self.link.dropped}
            if not self.link.connected:
                level, text = diagnostics.WARN, f"{text}, no connection to {self.config.datalink}"
        if self.gdrt is not None:
            values |= {"gdrt_sent": self.gdrt.sent, "gdrt_failed": self.gdrt.failed}
        for name, server in self.servers.items():
            values |= {f"{name}_clients": server.clients, f"{name}_dropped": server.dropped}
        utc_ns = self.export.newest_utc_ns
        self.diagnostics.publish(diagnostics.encoded("exporter", level, text, values, utc_ns))

    def close(self) -> None:
        """Write what has not filled a packet."""
        self.export.close()
        self.export.describe(self.folder)
        if self.link is not None:
            self.link.close()
        if self.gdrt is not None:
            self.gdrt.close()
        for server in self.servers.values():
            server.close()


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(ExporterNode(process)), "exporter")


if __name__ == "__main__":
    main()
