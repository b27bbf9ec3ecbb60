"""Our delays and data bits despread a signal that nobody here made.

What our simulator would send at a time is compared with what the outside one did send then.
"""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from deepseis_core.ca_code import ca_code
from deepseis_core.constants import L1_HZ, L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.nav_data import NavData
from deepseis_sim.signal_model import SignalModel, still

START = GpsTime.from_calendar(2022, 1, 1, 2)
COUNT = 2_400_000  # 0.6 s
SHIFTS = (-0.5, 0.0, 0.5)  # of the replica [chips]


@pytest.fixture(scope="module")
def folder(shared_data):
    return shared_data / "if_captures" / "independent_sim"


@pytest.fixture(scope="module")
def model(folder):
    position = ecef_from_geodetic([np.deg2rad(35.681298), np.deg2rad(139.766247), 10.0])
    ephemerides = read_rinex_nav(folder / "brdc0010.22n").ephemerides
    return SignalModel(
        visible_satellites(ephemerides, START, position), START, still(position), troposphere=False
    )


@pytest.fixture(scope="module")
def samples(folder):
    packing = IfFormat.from_text("independent_sim")
    i, q = np.empty(COUNT, np.int8), np.empty(COUNT, np.int8)
    name = folder / "still_40s_4MHz_1bit_iq.bin"
    packing.unpack(np.fromfile(name, np.uint8, count=packing.bytes_for(COUNT)), i, q)
    return i + 1j * q


def despread(model, samples, k):
    """Return sums over each data bit, shape (3, n_bits): the carrier with the code's iono sign."""
    time, at = np.arange(COUNT) / 4e6, np.arange(-0.1, 0.75, 0.02)
    delays = model.delays(at)
    path = (delays.range + delays.ionosphere)[:, k]
    phase = CubicSpline(at, L1_HZ * delays.satellite_clock[:, k] - path / L1_WAVELENGTH)(time)
    sent = time - CubicSpline(at, delays.pseudorange[:, k] / SPEED_OF_LIGHT)(time)
    mixed = samples * np.exp(-2j * np.pi * (phase % 1.0))
    code = ca_code(model.satellites[k].prn)
    bit = np.floor(sent / 0.02).astype(int)
    sums = []
    for shift in SHIFTS:
        despreaded = mixed * code[np.floor(1.023e6 * (sent % 1e-3) + shift).astype(int) % 1023]
        sums.append(
            np.bincount(bit - bit[0], despreaded.real)
            + 1j * np.bincount(bit - bit[0], despreaded.imag)
        )
    first = START.tow_ns // 20_000_000 + int(bit[0])
    bits = NavData(model.satellites[k].ephemeris, START.week).bits(first, len(sums[0]))
    return np.array(sums) * (1.0 - 2.0 * bits)


def test_code_phase_and_data_bits_are_where_the_outside_signal_has_them(model, samples):
    assert len(model.satellites) == 7
    for k in range(len(model.satellites)):
        sums = despread(model, samples, k)
        early, prompt, late = np.abs(sums.sum(axis=1))
        # 0.5 s at 40 dB-Hz measure a code phase to 0.005 chip (1.5 m); 4 sigma.
        assert abs(late - early) / (late + early) / 2 < 0.02
        # Bits: all whole ones have one sign (20 ms at 39 dB-Hz are 17 sigma). The first four end
        # a subframe 5, whose almanac is not ours; then come TLM, HOW, parity of subframe 1.
        turned = (sums[1] * np.conj(sums[1].sum()))[4:-1].real
        assert (turned > 0).all()
        assert prompt > 1.5 * max(early, late)
