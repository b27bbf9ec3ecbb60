"""The bits carry the ephemeris, from any bit on, across the week's end."""

import dataclasses

import numpy as np
import pytest

from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav_decoder import EphemerisEvent, IonosphereEvent, LnavDecoder
from deepseis_sim.nav_data import NavData
from deepseis_sim.nominal_constellation import nominal_constellation


def decode(ephemeris, week, first, count):
    decoder = LnavDecoder(ephemeris.satellite, week)
    bits = NavData(ephemeris, week).bits(first, count)
    return decoder.push(1.0 - 2.0 * bits.astype(float), 0)


@pytest.mark.parametrize("tow", [346258, 604790], ids=["midweek", "over the week's end"])
def test_a_decoder_gets_back_exactly_the_ephemeris(tow):
    ephemeris = nominal_constellation(GpsTime(2399, tow * 10**9))[4]
    events = decode(ephemeris, 2399, tow * 50 + 17, 40 * 50)
    (found,) = [event for event in events if isinstance(event, EphemerisEvent)][-1:]
    same = {"transmit_tow": 0.0, "effective_sample_index": -1, "iono_alpha": (), "iono_beta": ()}
    assert dataclasses.replace(found.ephemeris, **same) == dataclasses.replace(ephemeris, **same)


def test_the_default_frame_holds_the_ionosphere():
    ephemeris = nominal_constellation(GpsTime(2399, 346258 * 10**9))[4]
    events = decode(ephemeris, 2399, 346258 * 50, 40 * 50)
    (page,) = [event for event in events if isinstance(event, IonosphereEvent)]
    assert page.alpha == ephemeris.iono_alpha
    assert page.beta == ephemeris.iono_beta


def test_any_part_equals_the_same_part_of_the_whole():
    ephemeris = nominal_constellation(GpsTime(2399, 0))[0]
    whole = NavData(ephemeris, 2399).bits(-40, 2000)
    again = NavData(ephemeris, 2399)
    parts = [again.bits(first, 100) for first in range(-40, 1960, 100)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
