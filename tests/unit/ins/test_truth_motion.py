"""The antenna's trajectory from truth files: derivatives, layouts, bad files."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from phase_truth import MOVING, STATION

from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_ins.truth_motion import Trajectory, TruthMotion

W, RADIUS = 2 * np.pi * 2.0, 0.12


def circle(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration of 12 cm at 2 Hz."""
    axes = RADIUS * np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    sine, cosine = np.sin(W * t)[:, None], np.cos(W * t)[:, None]
    turn = sine * axes[0] + cosine * axes[1]
    slope = W * (cosine * axes[0] - sine * axes[1])
    return STATION + turn, slope, -(W**2) * turn


@pytest.mark.parametrize(("step", "tolerance"), [(0.002, 1e-6), (0.01, 1e-3)])
def test_spline_derivatives_are_those_of_the_motion(step, tolerance):
    time = np.arange(0.0, 2.0 + step / 2, step)
    t = np.linspace(0.2, 1.8, 777)
    states = Trajectory(time, circle(time)[0]).states(t)
    position, velocity, acceleration = circle(t)
    # A quintic spline's error falls with the sixth power of the step, its second derivative's
    # with the fourth: (W h)**4 = 2.5e-4 at 10 ms. Doubles hold ECEF to 1 nm.
    assert_allclose(states[:, 0:3], position, rtol=0, atol=tolerance * 1e-3 + 2e-9)
    assert_allclose(states[:, 3:6], velocity, rtol=0, atol=tolerance * 0.05 + 1e-6)
    assert_allclose(states[:, 6:9], acceleration, rtol=0, atol=tolerance * 5 + 3e-3)


def test_outside_its_points_the_antenna_stands_still():
    time = np.arange(0.0, 1.001, 0.002)
    position = circle(time)[0]
    states = Trajectory(time, position).states([-1.0, 3.0])
    assert_allclose(states[:, :3], position[[0, -1]], rtol=0, atol=1e-8)
    assert not states[:, 3:].any()


def test_scale_exaggerates_the_motion_about_its_start():
    time = np.arange(0.0, 1.001, 0.002)
    trajectory = Trajectory(time, circle(time)[0])
    true, wrong = trajectory.states([0.3]), trajectory.states([0.3], scale=0.5)
    assert_allclose(wrong[:, :3] - trajectory.origin, 0.5 * (true[:, :3] - trajectory.origin))
    assert_allclose(wrong[:, 3:], 0.5 * true[:, 3:])


def test_the_independent_simulators_circle_has_its_radius_speed_and_acceleration(shared_data):
    truth = TruthMotion(shared_data / "if_captures" / "independent_sim" / MOVING.truth)
    states = truth.trajectory.states(np.linspace(13.0, 29.0, 1000))
    centre = truth.trajectory.origin
    # Positions are printed to 0.1 um at 500 Hz: 0.1 um/(2 ms)^2 = 0.03 m/s^2 of noise.
    assert_allclose(np.linalg.norm(states[:, :3] - centre, axis=1), RADIUS, atol=1e-6)
    assert_allclose(np.linalg.norm(states[:, 3:6], axis=1), RADIUS * W, atol=1e-3)
    assert_allclose(np.linalg.norm(states[:, 6:9], axis=1), RADIUS * W**2, atol=0.3)
    before = truth.trajectory.states(np.linspace(1.0, 9.0, 100))
    assert_allclose(before[:, 3:6], 0.0, atol=1e-4)


def test_the_simulators_own_layout_is_read(tmp_path):
    time = np.arange(0.0, 1.001, 0.01)
    start = {"start_week": 2399, "start_tow_ns": 346_258 * 10**9}
    path = tmp_path / "truth.npz"
    np.savez(path, t_s=time, antenna_ecef=circle(time)[0], **start)
    truth = TruthMotion(path)
    assert truth.start == GpsTime(2399, 346_258 * 10**9)
    assert truth.trajectory.moves
    assert_allclose(truth.trajectory.states([0.5])[0, :3], circle(np.array([0.5]))[0][0])


def test_deepseis_sim_writes_that_layout(tmp_path):
    scenario = pytest.importorskip("deepseis_sim.still_recording")
    config = scenario.StillConfig(duration=0.1)
    recording = scenario.simulate_still(config, tmp_path)
    truth = TruthMotion(recording.truth_path)
    assert truth.start == config.start
    assert not truth.trajectory.moves
    assert_allclose(truth.trajectory.states([0.05])[0, :3], config.position_ecef, atol=1e-6)


def test_a_file_without_motion_needs_a_position(tmp_path):
    path = tmp_path / "truth.npz"
    np.savez(path, t_s=np.arange(3.0))
    with pytest.raises(InputError, match=r"truth\.npz: holds no motion"):
        TruthMotion(path)
    states = TruthMotion(path, STATION).trajectory.states([0.0, 1e3])
    assert_allclose(states[:, :3], [STATION, STATION])
    assert not states[:, 3:].any()


T = np.arange(10.0)
P = np.tile(STATION, (10, 1))


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"antenna_ecef_m": P}, "not its times"),
        ({"motion_t_s": T[:5], "antenna_ecef_m": P}, r"\(5,\) and \(10, 3\)"),
        ({"motion_t_s": T[:0], "antenna_ecef_m": P[:0]}, "are not"),
        ({"motion_t_s": T[::-1], "antenna_ecef_m": P}, "do not increase"),
        ({"motion_t_s": T, "antenna_ecef_m": P * np.nan}, "finite"),
        ({"motion_t_s": T, "antenna_ecef_m": P - STATION}, "not on the ground"),
        ({"motion_t_s": T, "antenna_ecef_m": np.full((10, 3), "a")}, "not made of numbers"),
        ({"t_s": T, "antenna_ecef": P, "start_week": T, "start_tow_ns": 0}, "not one number"),
    ],
)
def test_nonsense_is_refused_with_its_reason(tmp_path, arrays, reason):
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=rf"bad\.npz: .*{reason}"):
        TruthMotion(path)


def test_what_is_no_npz_is_refused_by_name(tmp_path):
    whole = tmp_path / "whole.npz"
    np.savez(whole, motion_t_s=T, antenna_ecef_m=P)
    for name, content in {
        "text.npz": b"hello",
        "empty.npz": b"",
        "cut.npz": whole.read_bytes()[:-200],
        "flipped.npz": whole.read_bytes().replace(P.tobytes()[:24], bytes(24), 1),
    }.items():
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=name):
            TruthMotion(path)
    np.save(tmp_path / "one.npy", T)
    with pytest.raises(InputError, match=r"is not an \.npz"):
        TruthMotion(tmp_path / "one.npy")
    with pytest.raises(InputError, match="is a directory"):
        TruthMotion(tmp_path)
    with pytest.raises(InputError, match="No such file"):
        TruthMotion(tmp_path / "nowhere.npz")
