import time

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.pvt.rtklib_reference import epochs
from unit.pvt.tracked_signals import KLOBUCHAR, L1_HZ, STATION, TOW, WEEK, C, Sky, first_epoch

from deepseis_core.ephemeris import pack, select_ephemerides, states_from_pseudoranges
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_pvt.spp import SppConfig, SppSolver

AIRLESS = SppConfig(ionosphere=False, troposphere=False)


def solve(
    sky,
    config=AIRLESS,
    *,
    t=2.0,
    bias=0.0,
    noise=0.0,
    rate_noise=0.0,
    klobuchar=None,
    keep=None,
    extra_rate_sd=None,
):
    """Return the solution of one simulated epoch."""
    pseudorange, doppler, ephemerides = first_epoch(sky, t, bias)
    pseudorange, doppler = pseudorange + noise, doppler + rate_noise
    states = states_from_pseudoranges(
        pack(ephemerides), WEEK, round((TOW + t + bias / C) * 1e9), pseudorange
    )
    chosen = slice(None) if keep is None else keep
    return SppSolver(config).solve(
        states[chosen],
        pseudorange[chosen],
        doppler[chosen],
        np.full(len(pseudorange), 45.0)[chosen],
        tow=TOW + t,
        klobuchar=klobuchar,
        extra_rate_sd=extra_rate_sd,
    )


@pytest.mark.parametrize("bias", [0.0, 150_000.0, -2e7])
def test_position_is_exact_from_the_centre_of_the_earth(bias):
    found = solve(Sky(), bias=bias)
    # RTKLIB's clock reads to 6e-11 s x 3.9 km/s; the receiver's own time is rounded to 1 ns.
    assert_allclose(found.position_ecef, STATION, rtol=0, atol=2e-4)
    assert_allclose(found.clock_bias, bias, rtol=0, atol=2e-4)


def test_velocity_and_drift_are_exact():
    velocity = np.array([30.0, -20.0, 10.0])
    found = solve(Sky(lambda t: STATION + velocity * (t - 2.0)))
    # Time of week in a double, 6e-11 s, over 20 ms of differencing at 900 m/s.
    assert_allclose(found.velocity_ecef, velocity, rtol=0, atol=2e-5)
    assert_allclose(found.clock_drift, 0.0, rtol=0, atol=2e-5)


def test_atmosphere_agrees_with_rtklibs():
    config = SppConfig(elevation_mask_deg=0.0)
    found = solve(Sky(atmosphere=True), config, klobuchar=KLOBUCHAR)
    # Elevation above the ellipsoid from the turned against the unturned satellite: 1e-7 rad.
    assert_allclose(found.position_ecef, STATION, rtol=0, atol=1e-3)
    without = solve(Sky(atmosphere=True), AIRLESS)
    assert np.linalg.norm(without.position_ecef - STATION) > 3.0


def test_residuals_scatter_as_the_covariance_says():
    rng = np.random.default_rng(7)
    config = SppConfig(
        ionosphere=False, troposphere=False, ephemeris_part=0.0, floor_sd=0.0, code_sd=1.0
    )
    base = solve(Sky(), config)
    sd = 1.0 / np.sqrt(np.sin(base.elevation))
    misses = []
    for _ in range(200):
        found = solve(Sky(), config, noise=rng.normal(0, sd))
        misses.append(found.position_ecef - STATION)
    # Trace of the sample covariance of 200 draws: 1 +- sqrt(2/200), taken at 4 sigma.
    ratio = np.sum(np.var(misses, axis=0)) / np.trace(base.covariance[:3, :3])
    assert abs(ratio - 1.0) < 0.4


def test_velocity_scatters_as_the_covariance_says():
    rng = np.random.default_rng(8)
    base = solve(Sky())
    sd = 0.05 / np.sin(base.elevation) * L1_HZ / C
    found = [solve(Sky(), rate_noise=rng.normal(0, sd)).velocity_ecef for _ in range(200)]
    ratio = np.sum(np.var(found, axis=0)) / np.trace(base.velocity_covariance[:3, :3])
    assert abs(ratio - 1.0) < 0.4


def test_velocity_of_wide_loops_scatters_as_the_covariance_says():
    """Their Doppler is worse by tens of the usual sigma: no reason to leave satellites out."""
    rng = np.random.default_rng(3)
    sd = np.full(len(solve(Sky()).elevation), 2.46)
    found = [
        solve(Sky(), rate_noise=rng.normal(0, sd), extra_rate_sd=sd * C / L1_HZ)
        for _ in range(200)
    ]
    velocity = [item.velocity_ecef for item in found]
    ratio = np.sum(np.var(velocity, axis=0)) / np.trace(found[0].velocity_covariance[:3, :3])
    assert 0.8 < ratio < 1.25
    assert np.isfinite([item.range_rate_residual for item in found]).all()


def test_one_outlier_is_excluded():
    noise = np.zeros(10)
    noise[3] = 60.0
    found = solve(Sky(), noise=noise)
    assert np.flatnonzero(found.rejected).tolist() == [3]
    assert found.consistent
    assert_allclose(found.position_ecef, STATION, rtol=0, atol=1e-3)
    assert_allclose(found.pseudorange_residual[3], 60.0, atol=1e-3)


def test_two_outliers_are_excluded():
    noise = np.zeros(10)
    noise[2], noise[6] = 100.0, -70.0
    found = solve(Sky(), noise=noise)
    assert np.flatnonzero(found.rejected).tolist() == [2, 6]


def test_a_false_doppler_does_not_move_the_velocity():
    rate_noise = np.zeros(10)
    rate_noise[4] = 40.0
    found = solve(Sky(), rate_noise=rate_noise)
    assert_allclose(found.velocity_ecef, 0.0, atol=1e-4)


def test_what_five_satellites_cannot_mend_is_owned_up_to():
    noise = np.array([0.0, 80.0, 0.0, 0.0, 0.0])
    keep = [0, 2, 4, 5, 6]
    honest = solve(Sky(), keep=keep)
    pseudo = np.zeros(10)
    pseudo[keep] = noise
    found = solve(Sky(), noise=pseudo, keep=keep)
    assert honest.consistent
    assert not found.consistent
    assert np.trace(found.covariance) > 10 * np.trace(honest.covariance)


def test_three_satellites_are_no_position():
    assert solve(Sky(), keep=[0, 1, 2]) is None


def test_dops_are_those_of_the_geometry():
    found = solve(Sky())
    e, a = found.elevation, found.azimuth
    design = np.column_stack(
        (np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e), np.ones(len(e)))
    )
    q = np.diag(np.linalg.inv(design.T @ design))
    expected = [q.sum(), q[:3].sum(), q[:2].sum(), q[2]]
    assert_allclose(found.dops, np.sqrt(expected), rtol=1e-9)


def test_an_epoch_of_ten_satellites_takes_less_than_the_budget():
    pseudorange, doppler, ephemerides = first_epoch(Sky())
    packed, solver, cn0 = pack(ephemerides), SppSolver(AIRLESS), np.full(10, 45.0)
    start = np.append(STATION + 5.0, 0.0)

    def once():
        began = time.perf_counter()
        for _ in range(50):
            states = states_from_pseudoranges(packed, WEEK, (TOW + 2) * 10**9, pseudorange)
            solver.solve(states, pseudorange, doppler, cn0, tow=TOW + 2.0, start=start)
        return (time.perf_counter() - began) / 50

    # 150 us is the goal on an idle machine; the best of ten runs is free of its neighbours.
    assert min(once() for _ in range(10)) < 300e-6


def test_recorded_positions_are_rtklibs_to_a_millimetre(shared_data):
    differences, speeds = compare_with_rtklib(shared_data / "gnss_ins" / "instinct_tckf_static")
    assert len(differences) > 600
    # The same data, models and weights; what remains is Sagnac to first order, 0.3 mm.
    assert np.max(differences) < 0.002
    # RTKLIB leaves out that the satellite moves during the flight: (1 km/s)^2 / c = 3 mm/s.
    assert np.max(speeds) < 0.01


def compare_with_rtklib(folder):
    """Return distances between both positions [m] and between both velocities [m/s]."""
    obs, nav = sorted(folder.glob("*.23O"))[0], sorted(folder.glob("*.nav"))[0]
    file = read_rinex_nav(nav)
    klobuchar = np.array([*file.iono_alpha, *file.iono_beta])
    # RTKLIB's variances: 0.3^2 + 0.3^2/sin(el) + 0.3^2 of code bias; its Doppler has equal ones.
    solver = SppSolver(SppConfig(floor_sd=0.3 * 2**0.5, code_sd=0.3, max_exclusions=0))
    unweighted = SppSolver(SppConfig(weighting="none", max_exclusions=0))
    differences, speeds = [], []
    for epoch in epochs(obs, nav):
        week, tow_ns = epoch.week, round(epoch.tow * 1e9)
        known = select_ephemerides(file.ephemerides, week, tow_ns)
        names = [n for n, v in epoch.values.items() if n in known and v[0]]
        code, _, doppler, cn0, _ = np.array([epoch.values[n] for n in names]).T
        states = states_from_pseudoranges(pack([known[n] for n in names]), week, tow_ns, code)
        # RTKLIB takes the upper end of a URA's class.
        accuracy = np.array([{2.0: 2.4, 2.8: 3.4}[known[n].accuracy] for n in names])
        given = {"tow": epoch.tow, "accuracy": accuracy, "klobuchar": klobuchar}
        found = solver.solve(states, code, doppler, cn0, **given)
        velocity = unweighted.solve(states, code, doppler, cn0, **given).velocity_ecef
        differences.append(np.linalg.norm(found.position_ecef - epoch.position_ecef))
        speeds.append(np.linalg.norm(velocity - epoch.velocity_ecef))
    return np.array(differences), np.array(speeds)
