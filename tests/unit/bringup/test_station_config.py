from dataclasses import fields
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from deepseis_bringup.cli import app
from deepseis_bringup.graph import ALL_SATELLITES, KINDS, build_graph
from deepseis_bringup.live.web_options import WebOptions
from deepseis_bringup.station_config import StationConfig, read_station_config, station_config
from deepseis_core.errors import InputError
from deepseis_frontend.nodes.if_source import SourceConfig
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.range_config import RangeConfig
from deepseis_pvt.nodes.pvt import NodeConfig
from deepseis_pvt.observables import ObservablesConfig
from deepseis_pvt.pvt_engine import PvtConfig
from deepseis_tracking.acquisition import AcquisitionConfig
from deepseis_tracking.acquisition_engine import RetryConfig
from deepseis_tracking.channel import TrackingConfig

EXAMPLE = Path(__file__).resolve().parents[3] / "ws/src/deepseis_bringup/config/station.yaml"
SETTINGS = {
    "acquisition": (AcquisitionConfig, RetryConfig),
    "tracker": (TrackingConfig,),
    "pvt": (NodeConfig, PvtConfig, ObservablesConfig),
    "fusion": (FusionConfig, RangeConfig),
}


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "if.bin"
    path.write_bytes(bytes(range(64)) * 4000)
    Path(f"{path}.yaml").write_text(
        "format: iq8\nsample_rate_hz: 4e6\nstart_utc: 2026-01-01T00:10:40Z\n"
    )
    return path


def read(tmp_path, text):
    path = tmp_path / "station.yaml"
    path.write_text(text)
    return read_station_config(path)


def test_the_example_shows_the_defaults():
    text = yaml.safe_load(EXAMPLE.read_text())
    config = read_station_config(EXAMPLE)
    default = StationConfig()
    assert set(text) == {item.name for item in fields(StationConfig)}
    for name in ("station", "satellites", "mode", "one_process", "record", "record_if"):
        assert getattr(config, name) == getattr(default, name)
    for key, value in text["source"].items():
        assert value == getattr(SourceConfig(), key), key
    for kind, values in text["parameters"].items():
        known = {k: v for config_type in SETTINGS[kind] for k, v in vars(config_type()).items()}
        for key, value in values.items():
            if key == "latency_slots":  # a station in real time has a default of its own
                assert default.options.parameters[kind][key] == value
                continue
            assert (value, type(value)) == (known[key], type(known[key])), key


def test_every_value_of_the_example_has_an_explanation():
    lines = EXAMPLE.read_text().splitlines()
    explained = ""
    for line in lines:
        if line.strip().startswith("#"):
            explained = "yes"
        elif not line.strip():
            explained = ""
        else:
            assert explained, line


def test_files_are_relative_to_the_configuration(tmp_path):
    config = read(
        tmp_path, "source: {file: if.bin}\nparameters: {pvt: {nav_file: a/b.rnx, rate_hz: 10}}"
    )
    assert config.source["file"] == str(tmp_path / "if.bin")
    assert config.parameters["pvt"] == {"nav_file": str(tmp_path / "a/b.rnx"), "rate_hz": 10}


def test_a_runs_folder_stands_for_its_bag(tmp_path):
    bag = tmp_path / "quake" / "bag"
    bag.mkdir(parents=True)
    (bag / "bag_0.mcap").touch()
    text = "source: {file: quake}\nimu: {file: quake}\nbase: {from: quake}"
    config = read(tmp_path, text)
    assert config.source["file"] == config.imu["file"] == config.base["from"] == str(bag)


def test_the_command_says_what_a_station_without_a_source_lacks(tmp_path):
    done = CliRunner().invoke(app, ["station", "-o", str(tmp_path / "run")])
    assert done.exit_code == 2
    assert "source.file names nothing" in done.output
    assert "station --example" in done.output
    assert not (tmp_path / "run").exists()


def test_the_graph_gets_what_the_file_says(tmp_path, recording):
    config = read(
        tmp_path,
        "station: DSEI\nsource: {file: if.bin, pace: 2, length_s: 1}\nsatellites: [G12, G05]\n"
        "mode: lockstep\none_process: false\nrecord_if: false\n"
        "parameters: {tracker: {pll_bandwidth_hz: 10.0}}",
    )
    specs = {spec.name: spec for spec in build_graph(config.graph(tmp_path / "run"))}
    assert set(specs) == {
        *("acquisition", "trackers_g05", "trackers_g12", "pvt", "recorder", "if_source")
    }
    source = specs["if_source"].parameters
    assert (source["file"], source["pace"], source["length_s"]) == (str(recording), 2.0, 1.0)
    assert specs["pvt"].parameters["sample_rate_hz"] == 4e6
    assert {spec.parameters["mode"] for spec in specs.values()} == {"lockstep"}
    tracker = specs["trackers_g12"].parameters
    assert (tracker["satellite"], tracker["pll_bandwidth_hz"]) == ("G12", 10.0)
    assert tracker["reference_week"] == 2399  # 2026-01-01
    assert "if/samples" not in specs["recorder"].subscribes
    assert specs["recorder"].parameters["directory"] == str(tmp_path / "run/bag")


def test_without_recording_there_is_no_recorder(tmp_path, recording):
    config = read(tmp_path, "source: {file: if.bin}\nrecord: false\n")
    assert config.mode == "realtime"
    assert "recorder" not in {spec.name for spec in build_graph(config.graph(tmp_path / "run"))}


def test_times_may_be_written_with_or_without_quotes(tmp_path):
    plain = read(tmp_path, "source: {start_utc: 2022-01-01T02:00:00}")
    quoted = read(tmp_path, "source: {start_utc: '2022-01-01 02:00:00'}")
    assert plain == quoted


def test_an_empty_file_is_a_station_without_a_source(tmp_path):
    config = read(tmp_path, "")
    assert config == StationConfig()
    assert config.satellites == ALL_SATELLITES
    with pytest.raises(InputError, match="names no file"):
        config.graph(tmp_path)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("- a\n- b", "is not a mapping"),
        ("a: [", "is not YAML"),
        ("stations: a", "unknown key stations in the file .known: station, source"),
        ("source: {fiel: a}", "unknown key fiel in source"),
        ("source: a.bin", "source is not a mapping"),
        ("source: {pace: fast}", "source.pace is 'fast', not a number"),
        ("satellites: [G05, R01]", r"satellites: R01 not in G01 to G32"),
        ("satellites: G05", "satellites is 'G05'"),
        ("satellites: []", "satellites is .*all, or a list"),
        ("mode: fast", "mode is 'fast' .realtime or lockstep"),
        ("record: 1", "record is 1 .true or false"),
        ("station: 7 hills", "station '7 hills' is no ROS name"),
        ("parameters: {trackers: {}}", "unknown key trackers in parameters"),
        ("parameters: {tracker: 5}", "parameters.tracker is not a mapping"),
    ],
)
def test_nonsense_is_refused_in_one_line(tmp_path, text, complaint):
    with pytest.raises(InputError, match=complaint) as caught:
        read(tmp_path, text)
    assert str(tmp_path / "station.yaml") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("what", ["missing", "folder", "binary"])
def test_unreadable_files_are_named(tmp_path, what):
    path = tmp_path / "station.yaml"
    if what == "folder":
        path.mkdir()
    elif what == "binary":
        path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"station\.yaml"):
        read_station_config(path)


def test_kinds_are_those_of_the_graph(tmp_path, recording):
    config = station_config({"source": {"file": str(recording)}}, tmp_path / "x.yaml")
    kinds = {spec.kind for spec in build_graph(config.graph(tmp_path))}
    inertial = {"imu_source", "motion_state", "fusion", "seismic_event"}
    assert kinds | inertial | {"truth_aiding", "base_source", "ldv_source"} == set(KINDS)


def test_the_base_by_network_or_file_serves_a_surveyed_antenna(tmp_path, recording):
    text = f"source: {{file: {recording}}}\n"
    place = "parameters: {pvt: {position_ecef: [4075580.0, 931854.0, 4801568.0]}}\n"
    live = "base: {from: 'ntrip://me@caster.example/BASE0'}\n"
    graph = read(tmp_path, text + place + live).graph(tmp_path)
    specs = {spec.name: spec.parameters for spec in build_graph(graph)}
    assert specs["base_source"]["base"] == "ntrip://me@caster.example/BASE0"
    assert specs["base_source"]["sample_rate_hz"] == 4e6
    assert specs["base_source"]["start_utc_ns"] > 1e18
    assert specs["pvt"]["wait_base"]
    known = live.replace("}", ", position_ecef: [1.0e6, 2.0e6, 6.0e6]}")
    graph = read(tmp_path, text + place + known).graph(tmp_path)
    assert graph.parameters["pvt"]["base_position_ecef"] == [1e6, 2e6, 6e6]
    with pytest.raises(InputError, match="whose place is not known"):
        read(tmp_path, text + live).graph(tmp_path)
    with pytest.raises(InputError, match="holds a password"):
        read(tmp_path, text + place + live.replace("me@", "me:secret@")).graph(tmp_path)
    with pytest.raises(InputError, match=r"base\.rtcm: does not exist"):
        read(tmp_path, text + place + "base: {from: base.rtcm}\n").graph(tmp_path)
    with pytest.raises(InputError, match=r"base\.position_ecef"):
        read(tmp_path, text + place + live.replace("}", ", position_ecef: [1, 2]}"))


def test_the_imu_and_how_it_stands(tmp_path, recording):
    imu = (
        "imu: {file: imu.csv, grade: mti-g, imu_to_antenna: [0, 0, 1.5],"
        " monument_ecef: [-3.957e6, 3.310e6, 3.737e6]}"
    )
    (tmp_path / "imu.csv").write_text(
        "t,ax,ay,az,gx,gy,gz\n" + "".join(f"{k / 100},0,0,9.8,0,0,0\n" for k in range(1, 5))
    )
    (tmp_path / "imu.csv.yaml").write_text(
        "accelerometer: {columns: [ax, ay, az]}\ngyroscope: {columns: [gx, gy, gz]}"
    )
    text = f"source: {{file: {recording.name}}}\nsatellites: [G01]\n"
    graph = read(tmp_path, text + imu).graph(tmp_path / "run")
    specs = {spec.name: spec.parameters for spec in build_graph(graph)}
    assert graph.aiding == "fusion"
    assert specs["imu_source"]["imu_file"] == str(tmp_path / "imu.csv")
    assert specs["imu_source"]["imu_to_antenna"] == [0.0, 0.0, 1.5]
    assert (specs["fusion"]["imu_grade"], specs["fusion"]["imu_rate_hz"]) == ("mti-g", 100.0)
    assert specs["trackers"]["aiding"] is True
    with pytest.raises(InputError, match=r"station.yaml.*imu_to_antenna has 2, not 3"):
        read(tmp_path, text + imu.replace("0, 0, 1.5", "0, 0"))
    with pytest.raises(InputError, match="unknown key lever in imu"):
        read(tmp_path, text + imu.replace("imu_to_antenna", "lever"))
    without = read(tmp_path, text).graph(tmp_path / "run")
    assert without.aiding == ""
    ldv = read(tmp_path, f"{text}{imu}\nparameters: {{fusion: {{coupling: ldv}}}}")
    with pytest.raises(InputError, match="takes the velocimeter from the source's bag"):
        build_graph(ldv.graph(tmp_path / "run"))


def test_the_file_says_where_the_live_page_is(tmp_path):
    assert read(tmp_path, "live_page: {address: 10.0.0.1}").live_page is None
    text = "live_page: {port: 9000, token_file: token, names: [seis.example.org]}"
    page = read(tmp_path, text).live_page
    expected = WebOptions(9000, "127.0.0.1", str(tmp_path / "token"), ("seis.example.org",))
    assert page == expected


@pytest.mark.parametrize("wrong", ["{port: many}", "{port: 70000}", "{names: a}", "{prot: 1}"])
def test_a_live_page_that_makes_no_sense_is_refused(tmp_path, wrong):
    with pytest.raises(InputError, match="live_page"):
        read(tmp_path, f"live_page: {wrong}")
