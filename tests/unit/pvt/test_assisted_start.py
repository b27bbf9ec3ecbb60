import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.pvt.test_pvt_engine import AIRLESS, RATE, flat, positions, run
from unit.pvt.tracked_signals import (
    KLOBUCHAR,
    STATION,
    TOW,
    WEEK,
    C,
    Receiver,
    Sky,
    ephemeris,
    first_epoch,
    visible,
)

from deepseis_core.ephemeris import pack
from deepseis_pvt.assisted_start import Assistance, predict_transmit_ms, resolve_bits
from deepseis_pvt.pvt_engine import PvtConfig, PvtEngine

NOW_NS = (WEEK * 604800 + TOW + 2) * 10**9


def heard(noise=0.0, atmosphere=True):
    """Return transmit times [ms, from NOW_NS], and the packed ephemerides."""
    pseudorange, _, ephemerides = first_epoch(Sky(atmosphere=atmosphere), 2.0)
    return -(pseudorange + noise) / C * 1000, pack(ephemerides)


@pytest.mark.parametrize("error", [0.0, 0.3, -7.0, 10.0, 60.0, -300.0])
def test_time_and_all_bits_are_resolved_from_minutes_of_coarse_time(error):
    sent_ms, packed = heard()
    assistance = Assistance(tuple(STATION + 1.0), 0)
    coarse_ns = NOW_NS + round(error * 1e9)
    whole, rest = resolve_bits(assistance, packed, sent_ms % 20, coarse_ns, KLOBUCHAR)
    assert_allclose(whole - NOW_NS // 10**6 + rest, sent_ms, rtol=0, atol=1e-9)


def test_range_noise_of_two_metres_never_leads_to_a_wrong_bit():
    rng = np.random.default_rng(3)
    assistance, right = Assistance(tuple(STATION), 0), 0
    for _ in range(100):
        sent_ms, packed = heard(rng.normal(0.0, 2.0, len(visible())))
        found = resolve_bits(assistance, packed, sent_ms % 20, NOW_NS + 10**10, KLOBUCHAR)
        if found is not None:
            assert_allclose(found[0] - NOW_NS // 10**6 + found[1], sent_ms, rtol=0, atol=1e-9)
            right += 1
    assert right > 50


def test_ranges_hundreds_of_metres_off_are_refused():
    rng = np.random.default_rng(4)
    sent_ms, packed = heard(rng.normal(0.0, 300.0, len(visible())))
    found = resolve_bits(Assistance(tuple(STATION), 0), packed, sent_ms % 20, NOW_NS, KLOBUCHAR)
    assert found is None


@pytest.mark.parametrize("bias", [0.0, 1e5])
def test_a_millisecond_is_predicted_from_position_and_time(bias):
    sent_ms, packed = heard(atmosphere=True)
    state = np.append(STATION + 2000.0, bias)
    gps_ns = NOW_NS + round(bias / C * 1e9)
    for row, ms in zip(packed, sent_ms, strict=True):
        expected = (TOW + 2) * 1000 + int(np.floor(ms))
        assert predict_transmit_ms(state, row, gps_ns, ms - np.floor(ms)) == expected
        # An integration's own code phase runs over several milliseconds.
        assert predict_transmit_ms(state, row, gps_ns, ms - np.floor(ms) + 7) == expected - 7
        assert predict_transmit_ms(state, row, gps_ns, ms - np.floor(ms) + 0.5) is None


def aligned(seconds):
    """Return messages of 20 ms integrations that begin at bit edges, transmit time not known."""
    receiver, out = Receiver(Sky()), {}
    for name in visible():
        travel_ms = 1000 * receiver.sky.travel(name, 0.0)[0]
        edge = int(np.ceil((travel_ms % 20) / 1000 * RATE))
        batch = receiver.messages(name, seconds, first_sample=edge)
        out[name] = [
            dataclasses.replace(m, transmit_ms=np.full(len(m.transmit_ms), -1)) for m in batch
        ]
    return out


def test_a_station_fixes_without_a_subframe():
    messages = aligned(1.0)
    assistance = Assistance(tuple(STATION), (WEEK * 604800 + TOW + 11) * 10**9, troposphere=False)

    def fresh(help_given):
        made = PvtEngine(PvtConfig(), RATE, visible(), spp=AIRLESS, assistance=help_given)
        for name in visible():
            made.push_ephemeris(ephemeris(int(name[1:])))
        return made

    assert run(fresh(None), messages) == []
    epochs = run(fresh(assistance), messages)
    found = positions(epochs)
    assert len(found) >= 8
    assert epochs[0][0].week == WEEK
    for p in found:
        assert_allclose(p.position_ecef, STATION, rtol=0, atol=1e-3)
    assert flat(epochs) == flat(run(fresh(assistance), messages))
