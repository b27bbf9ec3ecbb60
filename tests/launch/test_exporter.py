"""The exporter beside a station: records in the archive, at a ringserver's port, at receivers."""

import os
import socket
import subprocess
import time

import numpy as np
import pytest
from launch.test_nodes import listener
from sensor_msgs.msg import Imu
from unit.bringup.test_convert import (
    COARSE_LATE_NS,
    IMU_RATE,
    START,
    displacement,
    ephemeris,
    observations,
    precise,
    pvt,
    station,
)
from unit.bringup.test_datalink import Peer
from unit.bringup.test_rtcm import kinds

from deepseis_bringup.executables import executable
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.supervisor import own_domain
from deepseis_core.imu_message import encode_imu
from deepseis_core.ros import codecs, qos
from deepseis_core.types import ImuSample
from deepseis_core.types import InsSolution as SolutionValue
from deepseis_msgs.msg import (
    Displacement,
    Ephemeris,
    InsSolution,
    Observations,
    PrecisePosition,
    Pvt,
    Station,
)

pytestmark = [pytest.mark.launch, pytest.mark.timeout(120)]
SECONDS = 4


def insolution(sample_index):
    """Return a solution that says nothing but when its sample was."""
    none, one = np.zeros(0), np.zeros((1, 3))
    return SolutionValue(
        "imu_link", 0, False, 0, np.array([sample_index]), np.array([0]), 0, one, one,
        np.zeros((1, 4)), one, one, one, none, none, none, 0, none, none, none, 0,
        np.zeros(0, bool),
    )  # fmt: skip


def test_what_a_station_says_is_in_the_archive_and_at_the_ringserver(tmp_path):
    peer, seconds = Peer(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    seconds.bind(("127.0.0.1", 0))
    seconds.settimeout(10.0)
    ports = {name: free_port() for name in ("rtcm", "nmea")}
    with own_domain() as environment, listener(environment) as (node, until):
        program = str(executable("deepseis_bringup", "exporter"))
        parameters = (
            f"directory:={tmp_path}",
            f"datalink:=127.0.0.1:{peer.port}",
            f"gdrt:=127.0.0.1:{seconds.getsockname()[1]}",
            *(f"{name}:=127.0.0.1:{port}" for name, port in ports.items()),
            "rtcm_rate_hz:=5.0",
        )
        words = [w for item in parameters for w in ("-p", item)]
        arguments = ["--ros-args", "-r", "__ns:=/DSEI", *words]
        process = subprocess.Popen(
            [program, *arguments], env={**os.environ, **environment}, stderr=subprocess.PIPE
        )
        try:
            publish = {
                topic: node.create_publisher(kind, f"/DSEI/{topic}", profile)
                for topic, kind, profile in (
                    ("station", Station, qos.LATCHED),
                    ("gnss/pvt", Pvt, qos.STREAM),
                    ("ins/solution", InsSolution, qos.STREAM),
                    ("seismo/displacement", Displacement, qos.STREAM),
                    ("imu/data_raw", Imu, qos.STREAM),
                    ("gnss/observations", Observations, qos.STREAM),
                    ("gnss/ephemeris", Ephemeris, qos.LATCHED),
                )
            }
            until(lambda: all(p.get_subscription_count() for p in publish.values()), 60.0)
            receivers = {
                name: socket.create_connection(("127.0.0.1", port), 10.0)
                for name, port in ports.items()
            }
            speak(publish)
            until(lambda: process.poll() or len(list(tmp_path.rglob("*.D.*"))) == 15, 30.0)
            time.sleep(0.5)
        finally:
            process.terminate()
            errors = process.communicate(timeout=30)[1]
    peer.close()
    assert process.returncode == 0, errors
    said = {name: whole(receiver) for name, receiver in receivers.items()}
    numbers = kinds(said["rtcm"])
    assert [numbers.count(n) for n in (1077, 1019, 1006)] == [5 * SECONDS, 2, 2]
    assert said["nmea"].count(b"$GPGGA,015950.00") == 1
    assert said["nmea"].count(b"$GPGGA,") == 10 * SECONDS
    with seconds:
        heads = [seconds.recv(2000)[:24] for _ in range(SECONDS)]
    assert heads == [f"> DSEI 202201010159{50 + k}.00".encode() for k in range(SECONDS)]
    for path in tmp_path.rglob("*.D.*"):
        (trace,) = obspy_modules().read(str(path))
        assert trace.stats.npts == SECONDS * 200
        for at in range(0, path.stat().st_size, 512):
            assert path.read_bytes()[at : at + 512] in peer.received
    assert obspy_modules().read_inventory(str(tmp_path / "JP.DSEI.xml"))


def test_a_station_without_a_fusion_has_its_phases_displacement(tmp_path):
    with own_domain() as environment, listener(environment) as (node, until):
        process = subprocess.Popen(
            [
                str(executable("deepseis_bringup", "exporter")),
                *("--ros-args", "-r", "__ns:=/DSEI", "-p", f"directory:={tmp_path}"),
            ],
            env={**os.environ, **environment},
        )
        try:
            kinds = {"station": Station, "gnss/pvt": Pvt, "gnss/precise": PrecisePosition}
            publish = {
                topic: node.create_publisher(
                    kind, f"/DSEI/{topic}", qos.LATCHED if topic == "station" else qos.STREAM
                )
                for topic, kind in kinds.items()
            }
            until(lambda: all(p.get_subscription_count() for p in publish.values()), 60.0)
            utc_ns = START.to_utc_ns()
            publish["station"].publish(codecs.STATION.encode(station(), utc_ns))
            publish["gnss/pvt"].publish(codecs.PVT.encode(pvt(START, 0), utc_ns))
            time.sleep(2.5)  # a look at who publishes, once a second
            for k in range(200):
                moved = [1e-3 * k, 0.0, 0.0]
                value = precise(START.add_ns(k * 20_000_000), np.array(moved))
                publish["gnss/precise"].publish(codecs.PRECISE_POSITION.encode(value, utc_ns))
            until(lambda: list(tmp_path.rglob("*.10.BXE.D.*")), 20.0)
        finally:
            process.terminate()
            process.wait(30)
    (trace,) = obspy_modules().read(str(next(tmp_path.rglob("*.10.BXE.D.*"))))
    assert trace.data.tolist() == [1000 * k for k in range(200)]


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as any_free:
        return any_free.getsockname()[1]


def whole(receiver):
    """Return what a receiver got until the end."""
    with receiver, receiver.makefile("rb") as stream:
        return stream.read()


def speak(publish):
    """Say four seconds of everything."""
    coarse0 = START.to_utc_ns() - COARSE_LATE_NS
    publish["station"].publish(codecs.STATION.encode(station(), coarse0))
    orbit = ephemeris("G03", round(START.tow_s()))
    publish["gnss/ephemeris"].publish(codecs.EPHEMERIS.encode(orbit, coarse0))
    time.sleep(2.0)  # readers match writers in their own time
    for k in range(SECONDS * 10):
        time.sleep(0.05)
        time_ns = k * 10**8
        fix = pvt(START.add_ns(time_ns), k * 400_000)
        publish["gnss/pvt"].publish(codecs.PVT.encode(fix, coarse0))
        epoch = observations(START.add_ns(time_ns), 0.1)
        publish["gnss/observations"].publish(codecs.OBSERVATIONS.encode(epoch, coarse0))
        data = codecs.INS_SOLUTION.encode(insolution(k * 400_000), coarse0 + time_ns)
        publish["ins/solution"].publish(data)
    time.sleep(2.0)  # now the clocks are known
    for k in range(SECONDS * 10):
        time.sleep(0.05)
        batch = displacement(20 * k, 20, 200)
        publish["seismo/displacement"].publish(codecs.DISPLACEMENT.encode(batch, coarse0))
        for i in range(20 * k + 1, 20 * k + 21):
            end = i * 10**9 // IMU_RATE
            sample = ImuSample(0, [0.0, 0.0, 0.1], [0.0, 0.0, 9.8], 1e-9, 1e-6)
            publish["imu/data_raw"].publish(encode_imu(sample, coarse0 + end))


def test_without_a_folder_it_says_so_in_one_line():
    program = str(executable("deepseis_bringup", "exporter"))
    with own_domain() as environment:
        done = subprocess.run(
            [program],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert done.returncode == 2
    assert done.stderr.strip() == (
        "exporter: parameter directory of exporter: is empty (name the archive)"
    )
