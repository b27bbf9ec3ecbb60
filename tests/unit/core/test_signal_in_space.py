"""Geometry, codes and navigation bits at once: an outside simulator's IF, despread blindly."""

import numpy as np
import pytest

from deepseis_core import atmosphere, ephemeris, geodesy
from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_RATE_CPS, SPEED_OF_LIGHT
from deepseis_core.lnav_decoder import IonosphereEvent, LnavDecoder, SubframeEvent
from deepseis_core.propagation import line_of_sight
from deepseis_core.rinex_nav import read_rinex_nav

RATE = 4_000_000
S = 10**9
START_NS = 525_600 * S  # of the file, week 2190
STATION = geodesy.ecef_from_geodetic([np.radians(35.681298), np.radians(139.766247), 10.0])


def despread(folder, nav, prn: int, first_ms: int, n_ms: int, shift_chips: float = 0.0):
    """Correlate 1 ms pieces, code from predicted transmit time and carrier from the truth."""
    truth = np.load(folder / "still_truth.npz")
    best = ephemeris.select_ephemerides(nav.ephemerides, 2190, START_NS)[f"G{prn:02d}"]
    edges_ms = first_ms + np.arange(n_ms + 1)
    tow_ns = START_NS + edges_ms * 1_000_000
    los = line_of_sight(ephemeris.pack([best]), 2190, tow_ns, STATION)
    place = geodesy.geodetic_from_ecef(STATION)
    iono = atmosphere.klobuchar_delay(
        np.array(nav.iono_alpha),
        np.array(nav.iono_beta),
        place[0],
        place[1],
        los.elevation[0],
        los.azimuth[0],
        tow_ns[0] / S,
    )
    delay = (los.range[:, 0] + iono) / SPEED_OF_LIGHT - los.satellite_clock[:, 0]
    column = list(truth["prn"]).index(prn)
    phase = np.interp(edges_ms / 1e3, truth["t_s"], truth["carrier_phase_cycles"][:, column])
    rate = np.interp(edges_ms / 1e3, truth["t_s"], truth["carrier_doppler_hz"][:, column])
    packed = np.fromfile(
        folder / "still_40s_4MHz_1bit_iq.bin", np.uint8, n_ms * 1000, offset=first_ms * 1000
    )
    bits = np.unpackbits(packed).reshape(n_ms, -1, 2).astype(np.float32) * 2 - 1
    code = ca_code(prn).astype(np.float32)
    out = np.empty(n_ms, np.complex64)
    within = np.arange(RATE // 1000) / RATE
    for k in range(n_ms):
        slope = (delay[k + 1] - delay[k]) * 1e3
        chips = (edges_ms[k] * 1e-3 - delay[k] + (1 - slope) * within) * CA_RATE_CPS + shift_chips
        replica = code[np.floor(chips).astype(np.int64) % 1023]
        carrier = np.exp(-2j * np.pi * (phase[k] + rate[k] * within)).astype(np.complex64)
        signal = bits[k, :, 0] + 1j * bits[k, :, 1]
        out[k] = np.sum(signal * replica * carrier)
    departure_ms = edges_ms[:-1] - delay[:-1] * 1e3
    return out, departure_ms


@pytest.fixture
def folder(shared_data):
    return shared_data / "if_captures/independent_sim"


def test_page_18_of_the_signal_holds_the_ionosphere_of_the_file_it_was_made_from(folder):
    nav = read_rinex_nav(folder / "brdc0010.22n")
    first_ms, n_ms = 18_050, 6_100
    prompt, departure_ms = despread(folder, nav, 12, first_ms, n_ms)
    bit_of = np.floor((departure_ms + 0.5) / 20).astype(int)  # ms pieces: at most 1 in 20 is mixed
    numbers = np.arange(bit_of[0] + 1, bit_of[-1])
    sums = np.array([prompt[bit_of == number].sum() for number in numbers])
    signs = np.sign((sums * np.exp(-0.5j * np.angle(np.mean(sums**2)))).real)
    events = LnavDecoder("G12", 2190).push(signs, int(numbers[0]))
    (subframe,) = [event for event in events if isinstance(event, SubframeEvent)]
    assert (subframe.subframe_id, subframe.tow_ms) == (4, 525_618_000)
    assert subframe.bit_index == 900  # the bit that left 18 s after the file's start
    (iono,) = [event for event in events if isinstance(event, IonosphereEvent)]
    # The RINEX header prints four digits.
    np.testing.assert_allclose(iono.alpha, nav.iono_alpha, rtol=5e-4)
    np.testing.assert_allclose(iono.beta, nav.iono_beta, rtol=5e-4)
    np.testing.assert_allclose(iono.utc.a0, nav.utc.a0, rtol=0, atol=2.0**-31)
    assert (iono.utc.tot, iono.utc.week_t, iono.utc.leap_s) == (147456.0, 2191, 18)


def test_the_predicted_code_phase_is_that_of_the_signal(folder):
    nav = read_rinex_nav(folder / "brdc0010.22n")
    power = [
        np.sum(np.abs(despread(folder, nav, 12, 1000, 400, shift)[0]) ** 2)
        for shift in (-0.25, 0.25)
    ]
    early, late = np.sqrt(power)
    # Half-chip early-minus-late at 45 dB-Hz over 0.4 s: 0.005 chip; sampling at 4 MHz adds 0.01.
    offset = (1 - 0.25) * (late - early) / (late + early)
    assert abs(offset) < 0.03
