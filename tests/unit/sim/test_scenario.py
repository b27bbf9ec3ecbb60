import re

import pytest

from deepseis_core.errors import InputError
from deepseis_core.yaml_config import read_yaml
from deepseis_sim.bench import Bench
from deepseis_sim.scenario import FOLDER, load_scenario, scenario_names, summary_of

PAPERS = {
    "static",
    "sine-1hz",
    "sine-2hz",
    "quake",
    "shake-table",
    "artificial",
    "high-g",
    "drive",
    "gravity-lines",
}


def write(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


def test_the_papers_scenarios_are_there():
    assert set(scenario_names()) == PAPERS | {"coseismic"}


@pytest.mark.parametrize("name", sorted(PAPERS))
def test_every_scenario_has_a_title_a_source_and_both_forms(name):
    full, short = load_scenario(name), load_scenario(name, short=True)
    assert full.name == short.name == name
    assert full.title
    assert re.search("thesis|accelerometer|doppler|hatch|ldv", full.source)
    assert short.duration < full.duration
    assert short.duration <= 400.0


@pytest.mark.parametrize("name", sorted(PAPERS))
def test_settings_of_a_scenario_state_units_in_their_names_or_beside(name):
    for line in (FOLDER / f"{name}.yaml").read_text().splitlines():
        if re.match(r"\s*(duration|start|radius|amplitude): [0-9.]+$", line):
            assert line.startswith("  "), f"{line}: without a unit"  # short forms repeat


def test_the_long_forms_of_long_scenarios_make_observations():
    chosen = {name for name in PAPERS if not load_scenario(name).signal}
    assert chosen == {"artificial", "drive", "gravity-lines"}


def test_a_change_wins_over_the_file():
    scenario = load_scenario("sine-2hz", settings=["imu.grade=mti-g", "motion.0.radius=0.2"])
    assert scenario.imu.grade == "mti-g"
    assert scenario.motion[0].radius == 0.2


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("titel: x", 1, "titel is not known"),
        ("duration: -3", 1, "outside"),
        ("imu:\n  grade: best", 2, "is not known"),
        ("imu:\n  grade: mti-g accel_range_g=wide", 2, "no number"),
        ("motion:\n- kind: circle\n  radius: wide", 3, "no number"),
        ("motion:\n- kind: spiral", 2, "'spiral' of motion is not known"),
        ("seed: 1\nsky:\n  obstructions: 3", 3, "not a list"),
        ("receiver:\n  if_format: iq9", 1, "if_format"),
        ("short:\n  duration: 0", 2, "outside"),
        ("duration: 3\nduration: 4", 2, "given twice"),
        ("base: yes please", 1, "not a mapping"),
    ],
)
def test_a_bad_scenario_names_line_and_reason(tmp_path, text, line, reason):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_scenario(str(path))
    assert f"mine.yaml:{line}: " in str(caught.value)
    assert reason in str(caught.value)


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match="sine-1hz"):
        load_scenario("sine")


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"gone\.yaml"):
        load_scenario(str(tmp_path / "gone.yaml"))


def test_there_must_be_a_short_form_to_ask_for_one(tmp_path):
    with pytest.raises(InputError, match="no short form"):
        load_scenario(str(write(tmp_path, "title: x")), short=True)


def test_an_empty_short_form_is_none(tmp_path):
    path = write(tmp_path, "title: x\nshort:\n")
    assert load_scenario(str(path)).title == "x"
    with pytest.raises(InputError, match="no short form"):
        load_scenario(str(path), short=True)


def test_who_names_a_record_gets_it_or_an_error():
    assert load_scenario("quake").stand_in
    assert load_scenario("quake", settings=["motion.0.start=20"]).stand_in
    assert not load_scenario("quake", settings=["motion.0.file=gone.at2"]).stand_in


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("seed: 2\nimu: {rate_hz: 400}", 2, "IMU rate: is 400 Hz"),
        ("signal: false\nsky:\n  elevation_mask_deg: 89", 2, "no satellite is visible"),
        ("motion:\n- kind: profile\n  segments: []", 1, "nothing moves"),
        ("jammers:\n- frequency_offset_hz: 1e8", 1, "outside of the sampled band"),
        ("signal: false\npositions: {white_sd: [1]}", 2, "three values"),
    ],
)
def test_what_only_the_bench_finds_out_is_named_by_its_line_too(tmp_path, text, line, reason):
    with pytest.raises(InputError, match=reason) as caught:
        Bench(load_scenario(str(write(tmp_path, text))))
    assert f"mine.yaml:{line}: " in str(caught.value)


def test_the_summary_says_what_was_changed():
    loaded = load_scenario("static", short=True, settings=["seed=7", "imu=false"])
    said = summary_of(loaded)
    assert (said["short"], said["changes"], said["seed"]) == (True, ["seed=7", "imu=false"], 7)


def test_files_count_from_the_scenario_s_folder(tmp_path, monkeypatch):
    assert load_scenario(str(write(tmp_path, "title: x"))).folder == tmp_path
    monkeypatch.setenv("DEEPSEIS_DATA", str(tmp_path / "data"))
    assert load_scenario("quake").folder == tmp_path / "data"


def test_the_files_hold_nothing_but_settings():
    for name in PAPERS:
        assert set(read_yaml(FOLDER / f"{name}.yaml").value) >= {"title", "source", "short"}
