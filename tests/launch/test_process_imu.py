"""`process` with an IMU in a text file: recorded, its station described, the loops aided."""

import graph_runs
import numpy as np
import pytest
from graph_runs import command

from deepseis_core.geodesy import geodetic_from_ecef
from deepseis_core.imu_grades import grade_named
from deepseis_core.ros import codecs

pytestmark = [pytest.mark.launch, pytest.mark.slow, pytest.mark.timeout(180)]

LENGTH, RATE_HZ = 6.5, 200
EARTH_RATE = 7.292115e-5


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    """Nine satellites: with assistance a fix after 1.4 s."""
    place = tmp_path_factory.mktemp("sky")
    return graph_runs.recording(place, LENGTH, elevation_mask_deg=10.0)


@pytest.fixture(scope="module")
def antenna(sky):
    return geodetic_from_ecef(np.load(sky.truth_path)["antenna_ecef"][0])


@pytest.fixture(scope="module")
def imu(antenna, tmp_path_factory):
    """A unit at rest, forward to the east, as forward-right-down in g and deg/s."""
    random, grade = np.random.default_rng(3), grade_named("span-fsas")
    latitude = antenna[0]
    rate = np.degrees(EARTH_RATE * np.array([0.0, -np.cos(latitude), -np.sin(latitude)]))
    walk = np.sqrt(RATE_HZ) * np.array([grade.accelerometers.walk, grade.gyros.walk])
    path = tmp_path_factory.mktemp("imu") / "imu.csv"
    with path.open("w") as file:
        file.write("ms,ax,ay,az,gx,gy,gz\n")
        for k in range(1, round(LENGTH * RATE_HZ) + 1):
            force = np.array([0.0, 0.0, -0.9992]) + walk[0] / 9.80665 * random.standard_normal(3)
            turn = rate + np.degrees(walk[1]) * random.standard_normal(3)
            numbers = ",".join(f"{value:.9g}" for value in (*force, *turn))
            file.write(f"{k * 1000 / RATE_HZ:g},{numbers}\n")
    (path.parent / "imu.csv.yaml").write_text(
        "time: {column: ms, unit: ms}\n"
        "accelerometer: {columns: [ax, ay, az], unit: g}\n"
        "gyroscope: {columns: [gx, gy, gz], unit: deg/s}\n"
        "axes: [x, -y, -z]\n"
        "installation: {grade: span-fsas, orientation_xyzw: [0, 0, 0, 1]}\n"
    )
    return path


def test_an_imu_beside_the_recording_aids_the_loops(sky, antenna, imu, tmp_path):
    place = f"{np.degrees(antenna[0]):.9f} {np.degrees(antenna[1]):.9f} {antenna[2]:.3f}"
    options = ["--imu", imu, "--nav", sky.nav_path, "--position", place]
    result = command("process", sky.if_path, *options, "-o", tmp_path / "run", timeout=150.0)
    assert result.returncode == 0, result.stderr
    recorded = graph_runs.payloads(tmp_path / "run" / "bag")
    assert len(recorded["/imu/data_raw"]) == round(LENGTH * RATE_HZ)
    (station,) = [codecs.STATION.decode(data)[0] for data in recorded["/station"]]
    assert station.imu == "span-fsas"
    np.testing.assert_allclose(geodetic_from_ecef(station.monument_ecef), antenna, atol=1e-2)
    spans = [codecs.DOPPLER_AIDING.decode(data)[0] for data in recorded["/aiding/doppler"]]
    assert len(spans) == LENGTH * 50
    assert spans[-1].valid
    assert len(spans[-1].satellites) >= 9


def test_without_a_place_the_reason_is_said(sky, imu, tmp_path):
    result = command("process", sky.if_path, "--imu", imu, "-o", tmp_path / "run")
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert "imu.csv: the station's place is not known" in line
    assert not (tmp_path / "run").exists()
