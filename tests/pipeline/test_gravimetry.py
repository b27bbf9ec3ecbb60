"""From a simulated bag to gravity along its line, and a real car through outages."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from deepseis_bringup.accept import gravimetry_real as real
from deepseis_bringup.accept.kingston import read_kingston
from deepseis_bringup.cli import app
from deepseis_bringup.simulation.simulate import simulate
from deepseis_bringup.survey.gravimetry import LDV, Drive, GravimetryConfig, work_out
from deepseis_bringup.survey.gravimetry_files import read_installation, write_installation
from deepseis_bringup.survey.survey_data import data_of_bench
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import MGAL
from deepseis_core.rotation import euler_from_matrix
from deepseis_ins.gravimetry import low_pass
from deepseis_ins.ldv import LdvInstallation
from deepseis_sim.bench import Bench
from deepseis_sim.scenario import load_scenario

SETTINGS = ["duration=330", "motion.0.length=1000", "truth_rate_hz=1"]


@pytest.fixture(scope="module")
def bench():
    return Bench(load_scenario("gravity-lines", short=True, settings=SETTINGS))


@pytest.fixture(scope="module")
def drive(bench):
    return Drive(data_of_bench(bench), GravimetryConfig())


@pytest.fixture(scope="module")
def result(drive):
    return work_out([drive], drive.config, None)


def test_gravity_along_the_line_is_the_benchs(bench, result):
    """No GNSS from the first movement on; level free, as the accelerometers' bias leaves it."""
    solution = result.solutions[LDV][0]
    series = solution.series
    truth = low_pass(bench.gravity_disturbance(series.time), GravimetryConfig().filter, 1.0)
    error = (series.filtered - truth) / MGAL
    # White noise alone leaves 0.58 mGal of the accelerometers (tests/unit/ins): three times that.
    assert np.abs(error - error.mean()).max() < 1.8
    assert np.ptp(truth) / MGAL > 5.0


def test_the_line_is_driven_twice_and_passes_agree(result):
    (line,) = result.lines[LDV]
    assert [item.direction for item in line.passes] == [1, -1]


def test_calibration_finds_what_the_bench_put_in(bench, result):
    found = result.calibration.installation
    _, pitch, _ = np.degrees(euler_from_matrix(found.C_bd))
    # The accelerometers' bias tilts the IMU by 20 urad, and the pitch is that of the sensor in it.
    tilt = bench.imu_errors.truth(0, 1).accel_bias[0][0] / 9.8
    sd = np.degrees(np.hypot(found.sd[1], tilt))
    assert pitch == pytest.approx(-bench.scenario.ldv.misalignment_deg[1], abs=3.0 * sd)
    assert found.scale == pytest.approx(1e-3, abs=3.0 * found.sd[0] + 2e-5)  # cos of the yaw
    arm = found.lever_arm_b * [1.0, -1.0, -1.0] - bench.scenario.ldv.lever_arm
    assert np.all(np.abs(arm) < 4.0 * result.calibration.lever.sd)


def test_dead_reckoning_errs_as_it_says(bench, result):
    track = result.solutions[LDV][0].track
    from deepseis_core.geodesy import ecef_from_geodetic, enu_from_ecef

    enu = enu_from_ecef(ecef_from_geodetic(track.geodetic), bench.site.origin_ecef)
    error = enu - bench.motion.at(track.time - bench.clock(track.time)).position
    said = np.isfinite(track.sd[:, 0])
    sd = track.sd[said][:, [1, 0, 2]]
    assert np.all(np.abs(error[said]) < 4.0 * sd)
    assert np.hypot(error[-1, 0], error[-1, 1]) < 3.0


def test_bad_quality_is_not_used(drive, result):
    """Measurements that are marked unusable change nothing, however wrong."""
    ldv = drive.data.ldv
    wrong = ldv.velocity.copy()
    wrong[ldv.quality < 100.0] += 50.0
    assert (ldv.quality < 100.0).sum() > 100
    spoiled = Drive(replace(drive.data, ldv=replace(ldv, velocity=wrong)), drive.config)
    again = spoiled.by_ldv(result.calibration.installation)
    expected = result.solutions[LDV][0].series.filtered
    assert np.array_equal(again.series.filtered, expected)


def test_the_command_leaves_profiles_series_and_page(tmp_path):
    short = ["duration=230", "motion.0.length=600", "motion.0.start=40", "motion.0.rest=20"]
    scenario = load_scenario("gravity-lines", short=True, settings=["truth_rate_hz=1", *short])
    simulate(scenario, tmp_path / "in", progress=False)  # fmt: skip
    out = tmp_path / "out"
    run = CliRunner().invoke(app, ["gravimetry", str(tmp_path / "in"), "-o", str(out)])
    assert run.exit_code == 0, run.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["methods"][LDV][0]["passes"] == 2
    with (out / "profiles.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["method"] for row in rows} == set(summary["methods"])
    one = [row for row in rows if row["method"] == LDV and row["pass"] == "1"]
    assert [float(row["station_m"]) for row in one] == sorted(
        float(row["station_m"]) for row in one
    )
    assert "Profiles, SINS/LDV" in (out / "report.html").read_text()
    assert read_installation(out / "installation.json").scale == pytest.approx(1e-3, abs=2e-4)


def test_an_installation_reads_back_as_it_was_written(tmp_path, result):
    known = result.calibration.installation
    write_installation(known, tmp_path / "x.json")
    again = read_installation(tmp_path / "x.json")
    np.testing.assert_allclose(again.C_bd, known.C_bd, atol=1e-12)
    np.testing.assert_allclose(again.lever_arm_b, known.lever_arm_b)
    np.testing.assert_allclose(again.sd, known.sd)
    (tmp_path / "y.json").write_text('{"scale": "wide"}')
    with pytest.raises(InputError, match="no velocimeter's installation"):
        read_installation(tmp_path / "y.json")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere"], "nowhere"),
        (["nowhere", "--cutoff-hz", "-1"], "cutoff_hz"),
        (["nowhere", "--installation", "missing.json"], "missing.json"),
    ],
)
def test_bad_input_is_one_line(tmp_path, arguments, says):
    run = CliRunner().invoke(app, ["gravimetry", *arguments, "-o", str(tmp_path / "out")])
    assert run.exit_code == 2
    assert says in run.output
    assert len(run.output.strip().splitlines()[-1:]) == 1
    assert "Traceback" not in run.output


def test_a_drive_that_never_rests_is_refused(drive):
    data = drive.data
    moving = slice(round(80.0 / data.dt), round(160.0 / data.dt))
    cut = replace(
        data, delta_theta_b=data.delta_theta_b[moving], delta_vel_b=data.delta_vel_b[moving],
        imu_time_end=data.imu_time_end[: moving.stop - moving.start],
    )  # fmt: skip
    with pytest.raises(InputError, match="rests for"):
        Drive(cut, drive.config)


@pytest.mark.slow
def test_speed_bounds_the_error_of_a_real_car_through_outages(shared_data):
    """Thirteen outages of a minute: the speed of the diagnostics, good to 0.15 m/s, helps.

    0.15 m/s of noise and 0.5 deg of heading are 1 % of the way and some metres of the start.
    """
    drive = read_kingston(shared_data)
    alone, aided = (real.outage_growth(drive, with_speed=flag) for flag in (False, True))
    assert len(aided.way) >= 10
    assert np.median(aided.error[:, -1]) < 0.6 * np.median(alone.error[:, -1])
    assert np.median(aided.error[:, -1] / aided.way) < 0.015


def test_an_installation_without_sd_is_taken_as_exact(drive, result):
    known = result.calibration.installation
    track = drive.survey.run(drive.filter(), replace(known, sd=np.zeros(3)), until=100.0)
    assert np.array_equal(track.installation.C_bd, known.C_bd)
    assert track.installation.scale == known.scale
    nominal = replace(LdvInstallation.nominal(drive.config.ldv), lever_arm_b=known.lever_arm_b)
    track = drive.survey.run(drive.filter(), nominal, until=100.0)
    assert track.installation.scale != 0.0
