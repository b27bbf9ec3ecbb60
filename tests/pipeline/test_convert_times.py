"""Times of converted data against the bench's truth in true time, receiver clock 0.3 ms off."""

from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.accept.scene import Scene, aided
from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.bags.ros_definitions import TopicQos
from deepseis_bringup.export import convert
from deepseis_bringup.export.convert_survey import ConvertOptions
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.graph import topic_type
from deepseis_bringup.offline import OfflineChain, encode
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import bag_files
from deepseis_sim import scenario as scenarios
from deepseis_sim.motions import Circle
from deepseis_sim.sky import SkyConfig

pytestmark = pytest.mark.slow

ONSET, END = 12.0, 18.0
INPUTS = ("station", "imu/data_raw")
OUTPUTS = ("gnss/pvt", "motion/state", "seismo/displacement")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Six satellites; 12 cm at 2 Hz from the 12th to the 18th second."""
    circle = Circle(radius=0.12, frequency_hz=2.0, start=ONSET, duration=END - ONSET, ramp=0.5)
    base = scenarios.load_scenario("sine-2hz", short=True)
    small = replace(base, duration=18.5, motion=(circle,), sky=SkyConfig(satellites=6), base=None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepseis_bringup.accept.scene.load_scenario", lambda *_, **__: small)
        return Scene("sine-2hz", tmp_path_factory.mktemp("scene"), short=True)


@pytest.fixture(scope="module")
def archive(scene, tmp_path_factory):
    """Run the chain, write its inputs' and outputs' values as a bag, convert that."""
    folder = tmp_path_factory.mktemp("archive")
    config = scene.config(aided(8.0))
    records = {"parameters": {"pvt": f'{{"sample_rate_hz": {config.sample_rate_hz}}}'}}
    known = set()

    def write(topic, data, utc_ns):
        name, kind = f"/{topic}", topic_type(topic)[0]
        if name not in known:
            known.add(name)
            bag.add_topic(name, kind, TopicQos(depth=10, durability="volatile"))
        bag.write(name, kind, data, utc_ns, utc_ns)

    with BagWriter(folder / "bag", records) as bag:
        for message in McapScan(bag_files(scene.bag)[0]).messages():
            topic = message.channel.topic.lstrip("/")
            if topic in INPUTS:
                write(topic, bytes(message.data), message.log_time_ns)
        for output in OfflineChain(config).run():
            if output.topic in OUTPUTS:
                write(output.topic, encode(output), output.utc_ns)
    out = folder / "out"
    out.mkdir()
    options = ConvertOptions(station="DSEI")
    convert.convert(folder / "bag", "miniseed", out, options, print)
    return out


@pytest.fixture(scope="module")
def truth(scene):
    """Return true GPS times [ns] and velocity, acceleration, its rate (n, 3), east north up."""
    with np.load(scene.bag.parent / "truth.npz") as file:
        start = GpsTime(int(file["start_week"]), int(file["start_tow_ns"])).total_ns
        shown = file["motion_t_s"]  # by the receiver's clock
        bias = np.interp(shown, file["t_s"], file["clock_bias"])
        latitude, longitude, _ = geodetic_from_ecef(file["origin_ecef"])
        C = rotation_enu_ecef(latitude, longitude)
        velocity, acceleration = (file[k] @ C.T for k in ("velocity_ecef", "acceleration_ecef"))
    assert abs(bias).min() > 1e-4
    times = start + np.rint((shown - bias) * 1e9).astype(np.int64)
    return times, velocity, acceleration, np.gradient(acceleration, shown, axis=0)


def lateness(archive, truth, pattern, order, column):
    """Return how late a channel's samples are labelled, and one sigma [us]."""
    (trace,) = obspy_modules().read(str(next(archive.glob(f"*/*/*/{pattern}"))))
    first = GpsTime.from_utc_ns(trace.stats.starttime.ns).total_ns
    times = first + np.rint(np.arange(trace.stats.npts) * 1e9 / trace.stats.sampling_rate)
    seconds = (times - truth[0][0]) * 1e-9
    moving = (seconds > ONSET + 0.6) & (seconds < END - 0.6)
    grid = (truth[0] - truth[0][0]) * 1e-9
    value, rate = (
        np.interp(seconds[moving], grid, truth[k][:, column]) for k in (order, order + 1)
    )
    design = np.stack([rate, value, np.ones_like(value)], axis=1)
    error = trace.data[moving] / 1e6 - value
    found, *_ = np.linalg.lstsq(design, error, rcond=None)
    sigma = (error - design @ found).std() / np.sqrt((rate**2).sum())
    return -found[0] * 1e6, sigma * 1e6


@pytest.mark.parametrize(("letter", "column"), [("E", 0), ("N", 1)])
def test_imu_samples_carry_true_time_to_microseconds(archive, truth, letter, column):
    late, sigma = lateness(archive, truth, f"HN{letter}.D/*.00.*", 2, column)
    # Left after 320 us of clock: noise, and the circle's lever and cross-axis terms.
    assert abs(late) < 4 * sigma + 5.0


@pytest.mark.parametrize(("letter", "column"), [("E", 0), ("N", 1)])
def test_fused_velocity_is_in_true_time(archive, truth, letter, column):
    late, sigma = lateness(archive, truth, f"HX{letter}.D/*.31.*", 1, column)
    # The filter adds some 10 us of its own; the receiver's clock would be 320.
    assert abs(late) < 4 * sigma + 30.0
