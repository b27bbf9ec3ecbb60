"""What a run leaves: a bag that others' readers open, records of its making, RINEX."""

import json

import georinex
import numpy as np
import pytest
import yaml
from graph_runs import RATE, decode
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from unit.pvt.rtklib_reference import epochs

from deepseis_bringup.bags.info import bag_info
from deepseis_bringup.bags.mcap_file import McapFile
from deepseis_bringup.bags.run_records import input_hash, recorded_run, run_records
from deepseis_bringup.graph import GraphConfig, build_graph
from deepseis_core.geodesy import geodetic_from_ecef
from deepseis_core.interface import INTERFACE_VERSION
from deepseis_core.ros.convert import ns_from_stamp
from deepseis_sim.still_recording import StillConfig

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]


@pytest.fixture(scope="module")
def mcap_path(recorded):
    (path,) = recorded.bag.glob("*.mcap")
    return path


@pytest.fixture(scope="module")
def rinex(recorded):
    (obs,), (nav,) = recorded.folder.glob("*_GO.rnx"), recorded.folder.glob("*_GN.rnx")
    return obs, nav


def positions(recorded):
    """Position and time of week [ns] of every solution."""
    for data in recorded.payloads()["/gnss/pvt"]:
        yield decode("deepseis_msgs/msg/Pvt", data)


def test_rosbags_reads_every_message(recorded):
    expected = recorded.payloads()
    with AnyReader([recorded.bag]) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
        assert {topic: n for topic, n in counts.items() if n} == {
            topic: len(messages) for topic, messages in expected.items()
        }
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/if/samples":
                assert message.data.size * 2 == message.sample_count


def test_mcap_readers_read_it_and_decode_positions(recorded, mcap_path):
    with mcap_path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        statistics = reader.get_summary().statistics
        assert statistics.message_count == sum(map(len, recorded.payloads().values()))
        decoded = [
            item.decoded_message for item in reader.iter_decoded_messages(topics=["/gnss/pvt"])
        ]
    ours = list(positions(recorded))
    assert [list(m.position_ecef) for m in decoded] == [m.position_ecef.tolist() for m in ours]
    assert [m.tow_ns for m in decoded] == [m.tow_ns for m in ours]


def test_ros2_bag_would_open_it(recorded, mcap_path):
    facts = yaml.safe_load((recorded.bag / "metadata.yaml").read_text())
    facts = facts["rosbag2_bagfile_information"]
    assert facts["storage_identifier"] == "mcap"
    assert facts["relative_file_paths"] == [mcap_path.name]
    for topic in facts["topics_with_message_count"]:
        assert topic["topic_metadata"]["offered_qos_profiles"]
        assert topic["topic_metadata"]["serialization_format"] == "cdr"
        assert topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_")


def test_the_bag_tells_what_it_was_made_of(recorded, recording, satellites):
    info = bag_info(recorded.bag)
    assert info.is_whole
    assert info.interface_version == INTERFACE_VERSION
    records = info.metadata
    assert records["input"]["sha256"] == input_hash(recording.if_path)
    assert records["input"]["sha256"] == recorded.figures["input_sha256"]
    assert records["versions"].keys() >= {"numpy", "numba", "rclpy", "mcap", "python"}
    assert json.loads(records["parameters"]["trackers"])["satellites"] == list(satellites)
    assert json.loads(records["graph"]["pvt"])["executable"] == "pvt"
    assert str(recorded.folder) not in json.dumps(records)
    assert recorded_run(recorded.bag).satellites == satellites


def test_records_depend_on_the_input_alone(recording, satellites, tmp_path):
    def records(folder):
        config = GraphConfig(
            source={"file": str(recording.if_path)},
            sample_rate_hz=RATE,
            satellites=satellites,
            record_dir=str(tmp_path / folder / "bag"),
            output_dir=str(tmp_path / folder),
        )
        return run_records(config, build_graph(config), "0")

    assert records("one") == records("two")


def test_a_replay_takes_what_was_set_for_the_fusion_and_not_what_the_bag_tells(
    recording, satellites, tmp_path
):
    found = {"imu_grade": "mti-g", "monument_ecef": [1.0, 2.0, 3.0], "start_s": 5.0}
    config = GraphConfig(
        source={"file": str(recording.if_path)},
        sample_rate_hz=RATE,
        satellites=satellites,
        aiding="fusion",
        parameters={
            "fusion": {**found, "coupling": "tight"},
            "seismic_event": {"hypocentre": [1]},
        },
    )
    path = tmp_path / "a.mcap"
    writer = McapFile(path)
    for name, values in run_records(config, build_graph(config), "0").items():
        writer.add_metadata(name, values)
    writer.close()
    parameters = recorded_run(path).parameters
    assert parameters["fusion"] == {"coupling": "tight"}
    assert parameters["seismic_event"] == {"hypocentre": [1]}
    assert parameters["motion_state"] == {}


def test_the_fix_is_near_the_truth_as_its_covariance_says(recorded, recording):
    truth = np.load(recording.truth_path)["antenna_ecef"][0]
    solutions = list(positions(recorded))
    errors = np.array([m.position_ecef - truth for m in solutions])
    spread = np.array([np.trace(m.position_covariance_ecef.reshape(3, 3)) for m in solutions])
    # The mean of 7 s: code noise is correlated over a second, so still about 1 sigma.
    assert np.linalg.norm(errors.mean(axis=0)) < 3 * np.sqrt(spread.mean())
    assert np.sqrt(spread.mean()) < 20.0
    fix = decode("sensor_msgs/msg/NavSatFix", recorded.payloads()["/gnss/fix"][-1])
    latitude, longitude, height = geodetic_from_ecef(solutions[-1].position_ecef)
    expected = (np.degrees(latitude), np.degrees(longitude), height)
    assert (fix.latitude, fix.longitude, fix.altitude) == pytest.approx(expected, abs=1e-12)


def test_the_time_reference_tells_how_far_the_stations_clock_is_from_utc(recorded):
    """Simulated: 0.32 ms ahead, and 8e-8 more every second."""
    start_ns, off = StillConfig().start.to_utc_ns(), []
    for data in recorded.payloads()["/gnss/time_reference"]:
        said = decode("sensor_msgs/msg/TimeReference", data)
        shown, true = (ns_from_stamp(stamp) for stamp in (said.header.stamp, said.time_ref))
        off.append(shown - true - 320_000 - 80e-9 * (true - start_ns))
    # Three sigma of a position whose own is 20 m.
    assert np.abs(off).max() < 3 * 20.0 / 0.2998


@pytest.mark.filterwarnings("ignore:In a future version of xarray:FutureWarning")  # georinex's
def test_georinex_reads_the_observations(recorded, recording, rinex):
    data = georinex.load(rinex[0])
    assert set(data.sv.values) == set(recording.satellites)
    assert len(data.time) == len(recorded.payloads()["/gnss/observations"])
    assert np.isfinite(data["C1C"].values).all()
    assert np.abs(data["C1C"].values - 2.2e7).max() < 4e6
    navigation = georinex.load(rinex[1])
    assert {str(sv)[:3] for sv in navigation.sv.values} == set(recording.satellites)


def test_rtklib_positions_from_the_rinex_agree_within_half_a_metre(recorded, rinex):
    ours = {m.tow_ns // 1000: m for m in positions(recorded)}
    known = [
        decode("deepseis_msgs/msg/Ephemeris", data)
        for data in recorded.payloads()["/gnss/ephemeris"]
    ]
    # Same models: from when the ionosphere's parameters were known to us as well.
    first = min(e.effective_sample_index for e in known if len(e.iono_alpha))
    differences = []
    for epoch in epochs(*rinex):
        mine = ours.get(round(epoch.tow * 1e6))
        if mine is None or mine.sample_index <= first:
            continue
        differences.append(np.linalg.norm(epoch.position_ecef - mine.position_ecef))
    assert len(differences) > 10
    assert max(differences) < 0.5
