"""The gravity disturbance: size, scale, sign and that it is a harmonic function."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.errors import InputError
from deepseis_sim.gravity_field import MGAL, GravityField


def grid(size=60e3, step=500.0):
    line = np.arange(-size, size, step)
    east, north = np.meshgrid(line, line)
    return np.column_stack([east.ravel(), north.ravel(), np.zeros(east.size)])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rms_is_half_the_amplitude(seed):
    values = GravityField(amplitude_mgal=30.0).build(seed).disturbance(grid()) / MGAL
    assert np.sqrt(np.mean(values**2)) == pytest.approx(15.0, rel=0.1)  # a finite area
    assert np.abs(values).max() <= 15.0 * np.sqrt(2.0 * 8.0)  # all waves in phase


def test_no_wave_is_shorter_than_asked():
    field = GravityField(wavelength=2500.0, longest=12000.0).build(1)
    length = 2.0 * np.pi / np.linalg.norm(field.waves, axis=0)
    assert (length >= 2500.0).all()
    assert (length <= 12000.0).all()


def test_field_is_harmonic():
    """Laplace's equation by second differences: no source where the vehicle drives."""
    field, h = GravityField().build(1), 50.0
    points = np.random.default_rng(1).uniform(-5e3, 5e3, (50, 3)) * [1.0, 1.0, 0.05]
    centre = field.disturbance(points)
    second = np.array(
        [
            field.disturbance(points + h * axis)
            + field.disturbance(points - h * axis)
            - 2 * centre
            for axis in np.eye(3)
        ]
    )
    # what is left of h^4/12 f'''' : (k h)^2/12 of the terms that cancel
    assert np.abs(second.sum(axis=0)).max() < 5e-3 * np.abs(second).max()


def test_callable_is_the_disturbance_and_a_function_of_place_alone():
    field = GravityField().build(1)
    points = grid(2e3, 100.0)
    whole = field(points)
    assert np.array_equal(whole, field.disturbance(points))
    assert np.array_equal(whole[::-1], field.disturbance(points[::-1]))
    assert np.array_equal(whole[7:8], field.disturbance(points[7:8]))
    assert np.array_equal(whole, GravityField().build(1)(points))
    assert not np.array_equal(whole, GravityField().build(2)(points))


def test_no_amplitude_no_disturbance():
    assert not GravityField(amplitude_mgal=0.0).build(1)(np.ones((3, 3))).any()


def test_senseless_settings_are_refused():
    with pytest.raises(InputError, match="wavelength"):
        GravityField(wavelength=-1.0).build(1)


def test_positive_means_stronger_gravity():
    """An IMU at rest there reads more upward specific force: the sign the synthesizer takes."""
    from deepseis_sim.imu import ImuSynthesizer
    from deepseis_sim.motions import Still
    from deepseis_sim.site import Site

    site = Site((0.6, 2.0, 50.0))
    field = GravityField(amplitude_mgal=100.0).build(1)
    plain = ImuSynthesizer(Still(), site, 100.0).increments(0, 1)
    more = ImuSynthesizer(Still(), site, 100.0, gravity=field).increments(0, 1)
    added = (more.delta_vel - plain.delta_vel)[0] / plain.dt
    assert_allclose(added, [0.0, 0.0, field(np.zeros((1, 3)))[0]], atol=1e-10)
