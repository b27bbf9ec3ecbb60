"""Bit edges are found where data bits change, and nowhere else."""

import numpy as np
import pytest

from deepseis_tracking.bit_sync import bits_in, clear_edge, resolve_bits, search_bit_edge
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


def free_running(cn0_dbhz, doppler_hz, seed, count=1000):
    """Prompts of ``count`` periods under an NCO that leaves a Doppler; period 3 is the first."""
    random = np.random.default_rng(seed)
    amplitude = np.sqrt(2e-3 * 10 ** (cn0_dbhz / 10))
    bits = np.repeat(random.choice([-1.0, 1.0], count // 20 + 2), 20)
    signs = bits[(3 - EDGE) % 20 :][:count]
    turn = np.exp(2j * np.pi * (doppler_hz * 1e-3 * np.arange(count) + random.random()))
    prompts = amplitude * signs * turn + random.standard_normal((count, 2)) @ [1, 1j]
    return np.stack([prompts.real, prompts.imag], axis=1)


def test_weak_prompts_give_doppler_and_bit_edge_at_once():
    errors, edges = [], []
    for seed in range(60):
        doppler = np.random.default_rng([seed, 1]).uniform(-15.0, 15.0)
        energy = np.zeros(20)
        found = resolve_bits(free_running(29.0, doppler, seed), 3, -1, energy)
        errors.append(found - doppler)
        edges.append(clear_edge(energy, bits_in(1000)))
    # Cramer-Rao bound for frequency within bits of unknown phase
    bound = np.sqrt(6 / (10**2.9 * 1.0)) / (2 * np.pi * 0.02)
    assert np.std(errors) < 1.4 * bound
    assert abs(np.mean(errors)) < 4 * bound / np.sqrt(60)
    assert edges.count(EDGE) > 45, "those with few changes of bits wait for more signal"
    assert set(edges) <= {EDGE, -1}


def test_energies_add_up_where_one_stretch_is_not_enough():
    energy, edge = np.zeros(20), -1
    for part in range(8):
        prompts = free_running(26.0, 4.0, 100 + part)
        resolve_bits(prompts, 3, -1, energy)
        edge = clear_edge(energy, (part + 1) * bits_in(1000))
        if edge >= 0:
            break
    assert edge == EDGE


def test_noise_has_no_edge():
    for seed in range(60):
        energy = np.zeros(20)
        resolve_bits(free_running(-99.0, 0.0, seed), 3, -1, energy)
        assert clear_edge(energy, bits_in(1000)) == -1


def test_a_known_edge_is_kept_to():
    energy = np.zeros(20)
    found = resolve_bits(free_running(29.0, -8.0, 4), 3, EDGE, energy)
    assert found == pytest.approx(-8.0, abs=3.0)
