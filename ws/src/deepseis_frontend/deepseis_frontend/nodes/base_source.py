"""Node: plays a base station beside the IF samples, recorded or live."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.steady import every
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations as ObservationsValue
from deepseis_frontend.base_events import BaseReference, utc_of
from deepseis_frontend.base_link import BaseLink
from deepseis_frontend.base_player import BasePlayer
from deepseis_frontend.base_topic import StationBase
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.nodes.base_open import base_events
from deepseis_frontend.ntrip import STATION, Address, address_of, is_address
from deepseis_msgs.msg import Observations, Station, Watermark

JOIN_S: Final = 5.0
"""From another station's first word to our listening to its epochs: its own have joined [s]."""


@dataclass(frozen=True)
class SourceConfig:
    """What to play."""

    file: str = setting("", "folder or file of a bag with IF samples and a base [path]")
    base: str = setting(
        "",
        "a bag, RINEX, or RTCM 3: a file, ntrip://user@host:port/MOUNT, ntrips://, tcp://host:port;"
        " station://NAME: another station's topics; empty: the base is in `file` [-]",
    )
    sample_rate_hz: float = setting(4e6, "with base: IF sampling rate [Hz]", low=1e5)
    start_utc_ns: int = setting(0, "with base: UTC of sample 0 [ns since 1970]")
    base_stale_s: float = setting(
        5.0, "a base without an epoch for so long is lost [s]", low=0.2, high=600.0
    )
    base_silence_s: float = setting(
        10.0, "a connection without a new epoch for so long is made anew [s]", low=0.5, high=600.0
    )


class BaseSourceNode(Node):
    """In: flow/if_source. Out: base/observations, base/reference. Parameters: SourceConfig.

    With ``station://NAME`` /NAME/station and /NAME/gnss/observations too.

    An epoch follows the IF samples of its time, so it never runs ahead of the signal; that there
    is none is said by the watermark, and nobody waits for a base that is silent. Watermarks count
    epochs and references together.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("base_source")
        self.flow = Flow(self, process, "base_source", declare(self, FlowConfig))
        config = declare(self, SourceConfig)
        reject_unknown(self)
        self.link: BaseLink | StationBase | None = None
        self.heard_since: float | None = None
        if config.base:
            self.clock = SampleClock(config.start_utc_ns, config.sample_rate_hz)
        else:
            signal = IfBag(config.file)
            self.clock = SampleClock(signal.start_utc_ns or 0, signal.sample_rate_hz)
        if is_address(config.base):
            self.link = self.open(address_of(config.base), config.base_silence_s)
        source = self.link or base_events(config.base or config.file, self.clock)
        waits = self.flow.lockstep
        self.player = BasePlayer(source, self.clock, config.base_stale_s, waits=waits)
        self.publisher = self.flow.publish_on("base/observations", Observations, qos.STREAM)
        self.reference = self.flow.publish_on("base/reference", Station, qos.LATCHED)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.sent, self.second = 0, -1
        self.through, self.source_ended = -1, False
        if self.link is not None:
            # Not through the flow: what depends on the network counts for nothing else.
            self.health = self.create_publisher(DiagnosticArray, "/diagnostics", qos.STREAM)
            every(self, 0.02, self.work)
        self.flow.follow(["if_source"], self.on_source)

    def open(self, address: Address, silence_s: float) -> BaseLink | StationBase:
        """Connect to a live base.

        Another station's members wait for each other by counting who listens to them, so we listen
        to what it says latched, and to its epochs once it has run for a while.
        """
        if address.scheme != STATION:
            return BaseLink(address, self.clock, silence_s)
        base, name = StationBase(address, self.clock), address.host
        codecs.subscribe(self, codecs.STATION, f"/{name}/station", base.push_station, qos.LATCHED)

        def listen() -> None:
            if not base.connected:
                return
            self.heard_since = self.heard_since or time.monotonic()
            if time.monotonic() - self.heard_since > JOIN_S:
                timer.cancel()
                codecs.subscribe(
                    self,
                    codecs.OBSERVATIONS,
                    f"/{name}/gnss/observations",
                    lambda epoch, _utc_ns: base.push_epoch(epoch),
                    qos.STREAM,
                )

        timer = every(self, 0.2, listen)
        return base

    def on_source(self, msg: Watermark) -> None:
        """Take how far the signal is."""
        if self.flow.rejoins and self.flow.entry < 0 and self.flow.admits(msg.valid_through + 1):
            self.player.begin_at(self.flow.entry)
            self.second = int(self.flow.entry / self.clock.sample_rate_hz)
        self.through = max(self.through, msg.valid_through)
        self.source_ended |= msg.end_of_stream
        self.work()

    def work(self) -> None:
        """Play what belongs to the signal so far."""
        through = self.through
        if self.flow.rejoins and self.flow.entry < 0 and not self.source_ended:
            return
        player = self.player
        if self.link is not None:
            self.link.about_utc_ns = self.clock.utc_ns(max(0, through))
        valid = player.complete_through(through)
        while valid >= (mark := round((self.second + 1) * self.clock.sample_rate_hz)):
            self.play(mark)
            self.report(mark)
        self.play(valid)
        player.announce(valid)
        if valid >= 0:
            utc_ns = self.clock.utc_ns(valid)
            self.flow.send(valid, through, event_count=self.sent, utc_ns=utc_ns)
        if self.source_ended and valid >= through and not self.flow.ended:
            self.flow.finish()

    def play(self, through: int) -> None:
        """Publish what is due."""
        for event in self.player.due(through):
            self.publish(event)

    def publish(self, event: ObservationsValue | BaseReference) -> None:
        """Publish an epoch, or where the base is from an epoch on."""
        self.sent += 1
        utc_ns = utc_of(event)
        if isinstance(event, BaseReference):
            self.reference.publish(codecs.STATION.encode(event.station(), utc_ns))
            return
        self.publisher.publish(codecs.OBSERVATIONS.encode(event, utc_ns))

    def report(self, sample: int) -> None:
        """Publish the counters at the beginning of a second."""
        self.second += 1
        utc_ns, player = self.clock.utc_ns(sample), self.player
        level, text = diagnostics.OK, "playing"
        if player.look(sample):
            level, text = diagnostics.WARN, f"base lost: no epoch for {player.age_s(sample):.0f} s"
        if self.link is None:
            values = dict(player.counts)
            told = diagnostics.encoded("base_source", level, text, values, utc_ns)
            self.diagnostics.publish(told)
            return
        level = level if self.link.connected else diagnostics.WARN
        counts = {**player.counts, **{f"link_{k}": v for k, v in self.link.counts.items()}}
        text = f"{text}; {self.link.address}: {self.link.state}"
        self.health.publish(diagnostics.encoded("base_source", level, text, counts, utc_ns))

    def close(self) -> None:
        """End the connection."""
        if self.link is not None:
            self.link.close()


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(BaseSourceNode(process)), "base_source")


if __name__ == "__main__":
    main()
