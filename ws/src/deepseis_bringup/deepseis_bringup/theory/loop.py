"""Beyond the papers' formulas: the discrete loop that is really used, and a loop that is run."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from deepseis_bringup.theory.chart import OTHER, TOTAL, Chart, Comparison, Curve, degrees
from deepseis_tracking.loop_theory import allan_noise, root_sum_square
from deepseis_tracking.loop_theory_analog import AnalogLoop
from deepseis_tracking.loop_theory_discrete import DiscreteLoop
from deepseis_tracking.loop_theory_simulation import LoopRun, circle, simulate_loop

PERIOD: Final = 0.02  # [s]
ELEVATION: Final = np.radians(26.0)  # of the satellite whose discriminator the thesis shows
CN0: Final = 43.0  # [dB-Hz] of such a satellite
RAMP: Final = 1.0  # [s]
DURATION: Final = 102.0  # [s] with the ramp and a second to settle
CIRCLES: Final = {"sine-1hz": (0.5, 1.0), "sine-2hz": (0.12, 2.0)}  # [m], [Hz] T table 5.1
PUBLISHED: Final = {
    ("sine-1hz", 15.0): "28.96; 47.90",
    ("sine-1hz", 8.0): "46.31; 89.96",
    ("sine-2hz", 15.0): "26.39; 44.46",
    ("sine-2hz", 8.0): "51.73; 89.90",
}
"""RMS and maximum of the discriminator [deg], T tables 5.3 and 5.4."""


@cache
def run(scenario: str, bandwidth_hz: float, *, realised: bool) -> LoopRun:
    """Run the conventional loop on the thesis' circle."""
    gains = DiscreteLoop.design(2, bandwidth_hz, PERIOD, realised=realised).gains
    radius, frequency = CIRCLES[scenario]
    motion = circle(radius, frequency, ELEVATION, DURATION, PERIOD, ramp=RAMP)
    return simulate_loop(gains, PERIOD, motion, CN0, seed=1)


def charts() -> list[Chart]:
    """Discriminators of the thesis' circles, error and bandwidth, limit of the aided loop."""
    return [*_discriminators(), _motion_and_bandwidth(), _limit()]


def _discriminators() -> list[Chart]:
    time = PERIOD * (np.arange(int(DURATION / PERIOD), dtype=np.float64) + 0.5)
    shown = slice(0, int(5.0 / PERIOD))
    return [
        Chart(
            f"loop-{scenario}",
            f"Conventional loop on {scenario}",
            f"Output of the discriminator of a loop that is run at correlator level: order 2, "
            f"20 ms, the papers' analog constants, {np.degrees(ELEVATION):.0f}° elevation, "
            f"{CN0:.0f} dB-Hz. At 8 Hz it loses the carrier.",
            "time [s]",
            time[shown],
            tuple(
                Curve(
                    f"{b:.0f} Hz",
                    degrees(run(scenario, b, realised=False).discriminator[shown]),
                    TOTAL if b == 15.0 else "part",
                )
                for b in (8.0, 15.0)
            ),
            y_name="discriminator [deg]",
            y_range=(-95.0, 95.0),
            limit=None,
        )
        for scenario in CIRCLES
    ]


def _motion_and_bandwidth() -> Chart:
    bandwidth = np.linspace(4.0, 40.0, 73)
    curves = []
    for scenario, (radius, frequency) in CIRCLES.items():
        amplitude = radius * np.cos(ELEVATION)
        analog = [
            float(AnalogLoop.for_bandwidth(2, b).sinusoid_error(amplitude, frequency))
            for b in bandwidth
        ]
        printed, realised = (
            [_discrete_error(b, radius, frequency, realised=how) for b in bandwidth]
            for how in (False, True)
        )
        curves += [
            Curve(f"{scenario}, realised bandwidth", degrees(np.array(realised)), TOTAL),
            Curve(f"{scenario}, analog constants", degrees(np.array(printed)), OTHER),
            Curve(f"{scenario}, analog loop", degrees(np.array(analog))),
        ]
    return Chart(
        "loop-motion",
        "Phase error under the thesis' circles",
        "Amplitude in a linear loop of order 2 with 20 ms; beyond 45° the thesis gives up. A loop "
        "that really has the bandwidth asked for does not follow 2 g even with 40 Hz.",
        "noise bandwidth asked for [Hz]",
        bandwidth,
        tuple(curves),
        y_range=(0.0, 180.0),
        limit=45.0,
    )


def _discrete_error(bandwidth: float, radius: float, frequency: float, *, realised: bool) -> float:
    try:
        loop = DiscreteLoop.design(2, bandwidth, PERIOD, realised=realised)
    except ValueError:
        return np.nan
    error = float(loop.sinusoid_error(radius, frequency, ELEVATION))
    return error if np.isfinite(error) else np.nan


def _limit() -> Chart:
    bandwidth = np.linspace(1.0, 16.0, 61)
    loops = [DiscreteLoop.design(2, b, PERIOD) for b in bandwidth]
    thermal = np.array([float(loop.thermal_noise(45.0)) for loop in loops])
    clock = np.array([loop.oscillator_noise() for loop in loops])
    return Chart(
        "loop-limit",
        "Least true phase error of an aided loop",
        "Order 2, 20 ms, 45 dB-Hz, OCXO at rest, realised bandwidth. What the oscillator adds is "
        "common to all satellites; dashed, by the analog formula T 3.4.",
        "noise bandwidth [Hz]",
        bandwidth,
        (
            Curve("thermal and oscillator", degrees(root_sum_square(thermal, clock)), TOTAL),
            Curve("thermal", degrees(thermal)),
            Curve("oscillator, discrete loop", degrees(clock)),
            Curve("T 3.4, one-sided", degrees(allan_noise(bandwidth)), OTHER),
            Curve(
                "T 3.4 as printed", degrees(allan_noise(bandwidth, convention="as-printed")), OTHER
            ),
        ),
        y_range=(0.0, 5.0),
        limit=None,
    )


def comparisons() -> list[Comparison]:
    """Discriminators of conventional loops, T tables 5.3 and 5.4, beside ours."""
    rows, first = [], int(2.0 * RAMP / PERIOD)
    for (scenario, bandwidth), published in PUBLISHED.items():
        table = {"sine-1hz": "T table 5.3", "sine-2hz": "T table 5.4"}[scenario]
        for realised, name in ((False, "analog constants"), (True, "realised bandwidth")):
            loop = DiscreteLoop.design(2, bandwidth, PERIOD, realised=realised)
            found = run(scenario, bandwidth, realised=realised)
            radius, frequency = CIRCLES[scenario]
            lost = found.kept < found.error.size
            kept = f"carrier lost after {found.kept * PERIOD:.1f} s" if lost else "kept"
            linear = float(degrees(loop.sinusoid_error(radius, frequency, ELEVATION)))
            rows.append(
                Comparison(
                    table,
                    f"{scenario}, {bandwidth:.0f} Hz: discriminator RMS; max [deg]",
                    published,
                    f"{np.degrees(found.rms(first)):.2f}; {np.degrees(found.greatest(first)):.1f}",
                    f"{name}: really {loop.noise_bandwidth_hz:.1f} Hz; amplitude in a linear loop "
                    f"{linear:.1f}; {kept}",
                )
            )
    return rows
