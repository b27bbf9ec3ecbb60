"""A recorded bag as the bytes that a receiver would have sent: RTCM 3, NMEA."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from deepseis_bringup.export.convert_survey import ConvertOptions, Say, Survey
from deepseis_bringup.export.nmea import gga
from deepseis_bringup.export.rtcm_stream import RtcmConfig, RtcmStream

RTCM_TOPICS: Final = ("station", "gnss/ephemeris", "gnss/observations")


def to_rtcm(known: Survey, folder: Path, options: ConvertOptions, say: Say) -> list[Path]:
    """Write all epochs as MSM7, with the antenna's place and the ephemerides."""
    stream = RtcmStream(RtcmConfig(rtcm_rate_hz=options.rtcm_rate_hz))
    path, epochs = folder / "observations.rtcm3", 0
    with path.open("wb") as file:
        for topic, value, _ in known.bag.values(RTCM_TOPICS):
            if topic == "station":
                stream.take_station(value)
            elif topic == "gnss/ephemeris":
                file.write(stream.take_ephemeris(value))
            else:
                data = stream.take_observations(value)
                epochs += bool(data)
                file.write(data)
    if known.station is None:
        say("no surveyed place: messages 1005 and 1006 are left out")
    if not epochs:
        path.unlink()
        return []
    return [path]


def to_nmea(known: Survey, folder: Path, _options: ConvertOptions, _say: Say) -> list[Path]:
    """Write every position as a GGA sentence."""
    sentences = [gga(pvt) for _, pvt, _ in known.bag.values(("gnss/pvt",))]
    if not sentences:
        return []
    path = folder / "positions.nmea"
    path.write_bytes("".join(sentences).encode("ascii"))
    return [path]
