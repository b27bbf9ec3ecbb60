"""Geodesy against RTKLIB, published values and closed forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core import geodesy
from deepseis_core.constants import WGS84_A, WGS84_B, WGS84_E2


@pytest.fixture
def points() -> np.ndarray:
    """Latitude, longitude, height from the deep sea to GPS orbits, poles and equator too."""
    random = np.random.default_rng(3)
    lat = np.concatenate((random.uniform(-1, 1, 200) * np.pi / 2, [np.pi / 2, -np.pi / 2, 0.0]))
    lon = random.uniform(-np.pi, np.pi, lat.size)
    return np.stack([lat, lon, random.choice([-1e4, 0.0, 10.0, 9e3, 4e5, 2e7], lat.size)], -1)


def test_ecef_round_trips(points):
    back = geodesy.geodetic_from_ecef(geodesy.ecef_from_geodetic(points))
    # Rounding of coordinates of 1e7 m: 4e-9 m.
    assert_allclose(back[:, 2], points[:, 2], rtol=0, atol=2e-8)
    assert_allclose(back[:, 0], points[:, 0], rtol=0, atol=2e-15)
    off_pole = np.abs(points[:, 0]) < 1.57
    assert_allclose(back[off_pole, 1], points[off_pole, 1], rtol=0, atol=1e-12)


def test_ecef_agrees_with_rtklib(points):
    rtklib = pytest.importorskip("pyrtklib")
    for lat, lon, height in points:
        given, out = rtklib.Arr1Ddouble(3), rtklib.Arr1Ddouble(3)
        given[0], given[1], given[2] = lat, lon, height
        rtklib.pos2ecef(given, out)
        ours = geodesy.ecef_from_geodetic([lat, lon, height])
        assert_allclose(ours, [out[0], out[1], out[2]], rtol=0, atol=1e-8)


def test_axes_of_the_ellipsoid():
    assert_allclose(geodesy.ecef_from_geodetic([0.0, 0.0, 0.0]), [WGS84_A, 0, 0], atol=1e-9)
    assert_allclose(geodesy.ecef_from_geodetic([np.pi / 2, 0, 0]), [0, 0, WGS84_B], atol=1e-9)


def test_local_axes_are_the_derivatives_of_position_and_right_handed(points):
    points = points[np.abs(points[:, 0]) < 1.5]
    lat, lon, height = points.T
    enu = geodesy.rotation_enu_ecef(lat, lon)
    step = 1e-6
    for axis, column in ((1, 0), (0, 1), (2, 2)):  # longitude, latitude, height: E, N, U
        size = step * (1.0 if axis < 2 else 1e6)
        ahead, behind = points.copy(), points.copy()
        ahead[:, axis] += size
        behind[:, axis] -= size
        change = geodesy.ecef_from_geodetic(ahead) - geodesy.ecef_from_geodetic(behind)
        radius = {
            0: geodesy.meridian_radius(lat) + height,
            1: (geodesy.transverse_radius(lat) + height) * np.cos(lat),
            2: np.ones_like(lat),
        }[axis]
        slope = change / (2 * size * radius[:, None])
        assert_allclose(slope, enu[:, column], rtol=0, atol=1e-6)  # rounding / step
    assert_allclose(np.linalg.det(enu), 1.0, atol=1e-14)
    ned = geodesy.rotation_ned_ecef(lat, lon)
    assert_allclose(
        ned @ np.swapaxes(enu, -1, -2), [[[0, 1, 0], [1, 0, 0], [0, 0, -1]]] * lat.size, atol=1e-15
    )


def test_enu_of_points_round_trips():
    origin = geodesy.ecef_from_geodetic([0.6, 2.4, 50.0])
    enu = np.array([[1.0, 2.0, 3.0], [-100.0, 5.0, 0.5]])
    ecef = geodesy.ecef_from_enu(enu, origin)
    assert_allclose(geodesy.enu_from_ecef(ecef, origin), enu, atol=2e-9)


def test_radii_at_equator_and_pole():
    assert_allclose(geodesy.meridian_radius(0.0), WGS84_A * (1 - WGS84_E2))
    assert_allclose(geodesy.transverse_radius(0.0), WGS84_A)
    polar = WGS84_A**2 / WGS84_B
    assert_allclose(geodesy.meridian_radius(np.pi / 2), polar)
    assert_allclose(geodesy.transverse_radius(np.pi / 2), polar)


def test_normal_gravity_is_that_of_the_standard():
    # NGA.STND.0036 table 3.6: equator, pole; mean value 9.7976432223.
    assert_allclose(geodesy.normal_gravity(0.0), 9.7803253359, rtol=0, atol=1e-10)
    assert_allclose(geodesy.normal_gravity(np.pi / 2), 9.8321849379, rtol=0, atol=1e-10)
    sin_lat = (np.arange(20000) + 0.5) / 20000
    lat = np.arcsin(sin_lat)
    area = 1 / (1 - WGS84_E2 * sin_lat**2) ** 2  # surface element over sin(latitude)
    mean = np.average(geodesy.normal_gravity(lat), weights=area)
    assert_allclose(mean, 9.7976432223, rtol=0, atol=1e-9)


def test_gravity_falls_with_height_as_the_free_air_gradient():
    slope = (geodesy.normal_gravity(np.pi / 4, 1.0) - geodesy.normal_gravity(np.pi / 4, -1.0)) / 2
    assert_allclose(slope, -3.086e-6, rtol=0, atol=1e-9)  # textbook value, four digits
