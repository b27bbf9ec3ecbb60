"""Bit edges are found where data bits change, and nowhere else."""

import numpy as np
import pytest

from deepseis_tracking.bit_sync import search_bit_edge
from deepseis_tracking.channel_state import STATE

EDGE = 7


def first_edge(bits, cn0_dbhz, seed=1):
    """Edge that is found first in 1 ms prompts of a signal with these data bits."""
    random = np.random.default_rng(seed)
    amplitude = np.sqrt(2e-3 * 10 ** (cn0_dbhz / 10))  # in noise sigmas of 1 ms
    signs = np.repeat(bits, 20)[20 - EDGE :]
    states = np.zeros(1, STATE).view(np.recarray)
    state = states[0]
    for count, sign in enumerate(signs):
        state.period_count, state.mode_epochs = count, count + 1
        noise = random.standard_normal(2)
        edge = search_bit_edge(state, amplitude * sign + noise[0], noise[1])
        if edge >= 0:
            return edge
    return -1


@pytest.mark.parametrize("cn0_dbhz", [35.0, 41.0, 50.0])
def test_no_edge_is_found_where_bits_do_not_change(cn0_dbhz):
    assert first_edge(np.ones(100), cn0_dbhz) == -1


@pytest.mark.parametrize("cn0_dbhz", [32.0, 41.0, 50.0])
def test_the_edge_is_found_where_bits_change(cn0_dbhz):
    for seed in range(20):
        bits = np.random.default_rng(seed).choice([-1.0, 1.0], 250)
        assert first_edge(bits, cn0_dbhz, seed) == EDGE


def test_few_changes_delay_the_edge_but_do_not_move_it():
    for seed in range(20):
        bits = np.ones(250)
        bits[30:60] = bits[90:] = -1.0
        bits[150::2] = 1.0
        assert first_edge(bits, 41.0, seed) == EDGE
