"""An IMU as a text file of columns: its values to the bit, and one line on what is wrong."""

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock, utc_ns_from_iso
from deepseis_frontend.imu_file import ImuFile
from deepseis_frontend.imu_open import open_imu

G = 9.80665
START = "2026-01-01T00:10:40Z"
CLOCK = SampleClock(utc_ns_from_iso(START), 4e6)
PLAIN = """
accelerometer: {columns: [ax, ay, az], unit: m/s^2}
gyroscope: {columns: [gx, gy, gz], unit: rad/s}
"""
HEADER = "t,ax,ay,az,gx,gy,gz"


def write(folder, lines, text=PLAIN, header=HEADER):
    path = folder / "imu.csv"
    path.write_text("\n".join(([header] if header else []) + lines) + "\n")
    (folder / "imu.csv.yaml").write_text(text)
    return path


def rows(count=400, rate=200.0, values=(0.1, 0.2, 9.8, 0.01, 0.02, 0.03), begin=1, scale=1.0):
    return [
        ",".join(repr(float(v)) for v in ((begin + k) / rate * scale, *values))
        for k in range(count)
    ]


def first(folder, lines, text=PLAIN, header=HEADER):
    read = ImuFile(write(folder, lines, text, header), CLOCK)
    return next(read.samples()), read


def test_a_sample_is_stamped_at_its_interval_s_end_since_sample_0(tmp_path):
    sample, read = first(tmp_path, rows())
    assert (sample.sample_index, read.rate_hz) == (20_000, 200.0)
    assert sample.linear_acceleration.tolist() == [0.1, 0.2, 9.8]
    assert sample.angular_velocity.tolist() == [0.01, 0.02, 0.03]
    assert len(list(read.samples())) == 400


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_have_units(tmp_path, unit, scale):
    sample, read = first(tmp_path, rows(scale=scale), PLAIN + f"time: {{column: t, unit: {unit}}}")
    assert (sample.sample_index, read.rate_hz) == (20_000, 200.0)


@pytest.mark.parametrize(("stamp", "index"), [("begin", 40_000), ("middle", 30_000)])
def test_a_stamp_elsewhere_in_the_interval_is_moved_to_its_end(tmp_path, stamp, index):
    sample, _ = first(tmp_path, rows(), PLAIN + f"stamp: {stamp}")
    assert sample.sample_index == index


def test_time_may_count_from_a_utc_and_what_was_before_the_signal_is_left_out(tmp_path):
    zero = "time: {column: t, zero_utc: 2026-01-01T00:10:39Z}"
    sample, read = first(tmp_path, rows(), PLAIN + zero)
    assert sample.sample_index == 0
    assert len(list(read.samples())) == 201


@pytest.mark.parametrize(
    ("force", "rate", "values"),
    [
        ("g", "deg/s", (0.0, 0.0, 1.0, 0.0, 0.0, 90.0)),
        ("mg", "rad/s", (0.0, 0.0, 1000.0, 0.0, 0.0, np.pi / 2)),
        ("m/s", "rad", (0.0, 0.0, G / 200, 0.0, 0.0, np.pi / 400)),
        ("m/s^2", "deg", (0.0, 0.0, G, 0.0, 0.0, 0.45)),
    ],
)
def test_units_and_increments(tmp_path, force, rate, values):
    text = (
        f"accelerometer: {{columns: [ax, ay, az], unit: {force}}}\n"
        f"gyroscope: {{columns: [gx, gy, gz], unit: {rate}}}"
    )
    sample, _ = first(tmp_path, rows(values=values), text)
    np.testing.assert_allclose(sample.linear_acceleration, [0, 0, G], rtol=1e-12)
    np.testing.assert_allclose(sample.angular_velocity, [0, 0, np.pi / 2], rtol=1e-12)


def test_axes_are_turned_to_forward_left_up(tmp_path):
    # A unit in forward-right-down at rest: specific force is up, so -9.8 on its z.
    values = (0.1, -0.2, -9.8, 0.01, -0.02, -0.03)
    sample, _ = first(tmp_path, rows(values=values), PLAIN + "axes: [x, -y, -z]")
    assert sample.linear_acceleration.tolist() == [0.1, 0.2, 9.8]
    assert sample.angular_velocity.tolist() == [0.01, 0.02, 0.03]


def test_columns_may_be_numbered_and_set_apart_by_blanks(tmp_path):
    text = (
        "accelerometer: {columns: [5, 6, 7]}\ngyroscope: {columns: [2, 3, 4]}\n"
        "time: {column: 1}\nheader_lines: 0\ndelimiter: ' '"
    )
    lines = [f"{k / 200:.3f}  1e-2 2e-2   3e-2 0.1 0.2 9.8" for k in range(1, 50)]
    sample, _ = first(tmp_path, lines, text, header="")
    assert sample.linear_acceleration.tolist() == [0.1, 0.2, 9.8]


def test_a_gap_is_a_gap(tmp_path):
    lines = rows()
    _, read = first(tmp_path, lines[:100] + lines[300:])
    steps = np.diff([s.sample_index for s in read.samples()])
    assert read.rate_hz == 200.0
    assert sorted(set(steps.tolist())) == [20_000, 201 * 20_000]


@pytest.mark.parametrize(
    ("lines", "text", "reason"),
    [
        ([*rows(5)[:2], "0.02,0.1,abc,9.8,0,0,0"], PLAIN, r"line 4: ay is 'abc', not a number"),
        ([*rows(5)[:2], "0.02,0.1,0.2"], PLAIN, r"line 4: az is '', not a number"),
        ([*rows(5)[:2], "0.02,0.1,nan,9.8,0,0,0"], PLAIN, r"line 4: ay is 'nan'"),
        ([*rows(5), rows(5)[2]], PLAIN, r"line 7: time 0.015 comes after 0.025"),
        (rows(1), PLAIN, "less than two samples"),
        (rows(5), PLAIN.replace("az", "a_z"), r"has no column 'a_z': it has|has no column 'a_z'"),
        (rows(5), PLAIN.replace("m/s^2", "furlong"), r"imu.csv.yaml.*unit"),
        (rows(5), PLAIN + "axes: [x, y, -z]", "not right-handed"),
        (rows(5), PLAIN + "axes: [x, y, w]", "axes has 'w'"),
        (rows(5), PLAIN + "scale: 3", r"scale is not known"),
        (rows(5), "accelerometer: {columns: [ax, ay, az]}", "gyroscope is missing"),
        (rows(5, values=(0, 0, 1.0, 0, 0, 0)), PLAIN, "specific force of 1 m/s"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, lines, text, reason):
    with pytest.raises(InputError, match=reason) as found:
        list(ImuFile(write(tmp_path, lines, text), CLOCK).samples())
    assert "\n" not in str(found.value)


def test_a_file_without_description_and_none_at_all_are_refused(tmp_path):
    path = tmp_path / "imu.csv"
    with pytest.raises(InputError, match="does not exist"):
        open_imu(path, CLOCK)
    path.write_text(HEADER + "\n")
    with pytest.raises(InputError, match=r"has no imu.csv.yaml beside it"):
        open_imu(path, CLOCK)


def test_how_it_stands_may_be_said_beside_the_columns(tmp_path):
    text = PLAIN + "installation: {grade: mti-g, imu_to_antenna: [0, 0.1, 1.5]}"
    stands = ImuFile(write(tmp_path, rows(), text), CLOCK).format.installation
    assert (stands.grade, stands.imu_to_antenna) == ("mti-g", (0.0, 0.1, 1.5))
    with pytest.raises(InputError, match="imu_to_antenna has 2, not 3"):
        first(tmp_path, rows(), text.replace("0, 0.1, 1.5", "0, 0.1"))
