"""The acceptance without gyroscopes: its tables say what the runs were, and catch what lies."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_bringup.accept import gyrofree as accept
from deepseis_bringup.accept.gyrofree_runs import Stations
from deepseis_sim.scenario import load_scenario

SCENARIO = """\
title: 70 s of rest, then a circle for 30 s
source: test
duration: 100.0
signal: false
motion:
  - {kind: circle, radius: 0.1, frequency_hz: 0.5, start: 70.0, duration: 30.0}
imu:
  grade: accelerometers
  rate_hz: 100.0
positions:
  correlation_time: [60.0, 60.0, 60.0]
"""
RUNS = 12


@pytest.fixture(scope="module")
def stations(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "circle.yaml"
    path.write_text(SCENARIO)
    return Stations(load_scenario(str(path)))


@pytest.fixture(scope="module")
def runs(stations):
    return [stations.run(seed) for seed in range(1, RUNS + 1)]


def value(rows, scenario, quantity):
    (row,) = [r for r in rows if scenario in r.scenario and r.quantity == quantity]
    return row


def test_the_onset_is_noticed_in_every_run(stations, runs):
    for ways in runs:
        assert 69.0 < ways.onset < 70.2
        assert 70.0 < ways.noticed < 70.5


def test_errors_are_those_of_the_tables(stations, runs):
    rows = accept.paper_rows(stations, runs)
    gnss = np.concatenate([ways.gnss[70:] for ways in runs])
    assert value(rows, "GNSS", "error, up").ours == pytest.approx(
        100.0 * np.sqrt(np.mean(gnss[:, 2] ** 2))
    )
    left = np.concatenate([ways.nine.smoothed[700:] for ways in runs])
    expected = 100.0 * (1.0 - np.sqrt(np.mean(left[:, 0] ** 2) / np.mean(gnss[:, 0] ** 2)))
    got = value(rows, "smoothed", "gain over GNSS, east")
    assert got.ours == pytest.approx(expected)
    assert got.published == 19.4


def test_what_the_station_knows_helps_and_the_tables_show_it(stations, runs):
    modelled, still = accept.drift_rows(stations, runs), accept.still_rows(stations, runs)
    for axis in accept.AXES:
        name = f"gain over GNSS, {axis}"
        with_still = value(still, "smoothed", name)
        assert with_still.ours > value(modelled, "smoothed", name).ours
        assert with_still.ours > value(still, "forward", name).ours
        # Expectation of the limit; 12 runs scatter by some 5 %.
        assert with_still.ours < with_still.limit + 15.0


def test_a_covariance_that_lies_is_caught(stations, runs):
    honest = accept.consistency_rows(stations, runs)
    assert all(row.met for row in honest if "normalised" in row.quantity)
    lying = [
        replace(ways, twelve=replace(ways.twelve, P_smoothed=0.4 * ways.twelve.P_smoothed))
        for ways in runs
    ]
    caught = [row for row in accept.consistency_rows(stations, lying) if row.met is False]
    assert [row.scenario for row in caught] == [f"{accept.TWELVE}, smoothed"]


def test_the_page_has_all_pictures(stations, runs, tmp_path):
    acceptance = accept.tables(stations, runs, "A circle")
    acceptance.write(tmp_path)
    page = (tmp_path / "gyrofree.html").read_text()
    for text in ("Displacement, run 1", "Errors, run 1", "Spectra of errors", "out of reach"):
        assert text in page
    lines = (tmp_path / "gyrofree.csv").read_text().splitlines()
    assert len(lines) == 1 + len(acceptance.rows)
    panels = [panel for _, figures in acceptance.figures for f in figures for panel in f.panels]
    assert len(panels) == 12
    names = [trace.get("name") for trace in panels[0].data]
    assert names == ["truth", "filter, 12 states", "still known, smoothed", "GNSS"]


def test_the_truth_is_that_of_the_motion(stations):
    """A circle of 10 cm, once the motion has come up to speed."""
    k = stations.time > 80.0
    assert_allclose(np.ptp(stations.truth[k], axis=0)[:2], 0.2, atol=2e-3)
    assert_allclose(stations.truth[stations.time <= 70.0], 0.0, atol=1e-12)
    k = stations.looks_at(85)
    assert_allclose(stations.truth[k], stations.at_epochs[85], atol=1e-9)
