"""Damaged input of every kind: read, or refused in one line; `DEEPSEIS_FUZZ=long` for hours."""

import os

import pytest
from fuzz_outside import all_targets
from fuzz_targets import check, damaged, prepare
from hypothesis import HealthCheck, given, settings

LONG = os.environ.get("DEEPSEIS_FUZZ") == "long"
PROFILE = settings(
    max_examples=20_000 if LONG else 40,
    deadline=None,
    derandomize=not LONG,  # the same examples every time: who changes nothing breaks nothing
    database=None,
    suppress_health_check=list(HealthCheck),
)
TARGETS = all_targets()


@pytest.mark.timeout(0 if LONG else 120)
@pytest.mark.parametrize("name", TARGETS)
def test_a_reader_reads_or_says_in_one_line_why_not(tmp_path, name):
    target = TARGETS[name]
    prepare(target, tmp_path)

    @PROFILE
    @given(damaged(target))
    def holds(data):
        check(target, data, tmp_path)

    holds()


ALONE = {"accelerogram": 2, "chunk": 1}
"""Examples that are refused although nothing is damaged: one component of three; no index."""


@pytest.mark.parametrize("name", TARGETS)
def test_every_reader_reads_its_examples_when_they_are_whole(tmp_path, name):
    target = TARGETS[name]
    prepare(target, tmp_path)
    read = [check(target, seed, tmp_path) for seed in target.seeds]
    assert read.count(False) == ALONE.get(name, 0)
