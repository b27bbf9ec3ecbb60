"""What gravity adds to a survey's accelerometers, in the short run and over hours."""

from dataclasses import replace

import numpy as np
import pytest

from deepseis_core.imu_grades import MGAL, grade_named
from deepseis_ins.error_state import bias_models
from deepseis_ins.survey_records import SurveyConfig, survey_grade

GRADE, CONFIG = grade_named("navigation"), SurveyConfig()
LEVEL = np.array([0.0, 0.0, -9.8])


def test_over_hours_gravity_moves_the_velocity_as_much_either_way():
    """Sum over an hour of a Gauss-Markov process drawn as said, against the random walk."""
    rng, step, runs = np.random.default_rng(5), 1.0, 400
    s, T, n = CONFIG.gravity_sd_mgal * MGAL, CONFIG.gravity_time, 3600
    decay = np.exp(-step / T)
    value, velocity = s * rng.standard_normal(runs), np.zeros(runs)
    for _ in range(n):
        velocity += step * value
        value = decay * value + s * np.sqrt(1.0 - decay**2) * rng.standard_normal(runs)
    white = survey_grade(GRADE, CONFIG, lasting=True).accelerometers.walk
    own = GRADE.accelerometers.walk
    # 400 runs tell a sigma to 3.5 %; the process' first correlation time is missing, 1.4 %.
    assert velocity.std() == pytest.approx(np.sqrt((white**2 - own**2) * n * step), rel=0.12)


def test_over_hours_the_turn_on_bias_is_remembered():
    """The one state's correlation time: minutes beside gravity, hours without it."""
    short, lasting = (
        bias_models(survey_grade(GRADE, CONFIG, lasting=lasting), LEVEL)[1]
        for lasting in (False, True)
    )
    assert short.correlation_time[0] < 300.0
    assert lasting.correlation_time[0] > 24.0 * 3600.0
    assert lasting.sd[0] == pytest.approx(GRADE.accel_bias, rel=0.5)


def test_better_known_gravity_than_the_bias_wanders_changes_nothing_in_the_short_run():
    known = replace(CONFIG, gravity_sd_mgal=0.1)
    assert survey_grade(GRADE, known) is GRADE
