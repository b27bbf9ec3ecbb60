import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.bags.ros_definitions import Definitions
from deepseis_bringup.report import document as report_document
from deepseis_bringup.report import run_report as report
from deepseis_bringup.report.plot import envelope, with_breaks
from deepseis_bringup.report.run_data import RunData
from deepseis_bringup.report.run_truth import Truth, phase_errors, remove_common
from deepseis_bringup.report.timeline import CODE, PHASE, PULL_IN, SEARCH, states, stretches
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu, ecef_from_geodetic

OWN = Path(__file__).parents[3] / "ws" / "src" / "deepseis_msgs" / "msg"
STORE = get_typestore(Stores.ROS2_JAZZY)
TEXTS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
}
for kind in ("deepseis_msgs/msg/TrackingEpochs", "deepseis_msgs/msg/Pvt"):
    TEXTS[kind] = (OWN / f"{kind.split('/')[2]}.msg").read_text()
    STORE.register(get_types_from_msg(TEXTS[kind], kind))

RATE, BLOCK, START_NS = 1_000_000.0, 20_000, 1_700_000_000 * 10**9
SATELLITES = ("G02", "G07", "G11", "G20", "G31")
SECONDS, FIRST_FIX = 8.0, 4.0
NOISE = {s: 0.004 * (k + 1) for k, s in enumerate(SATELLITES)}  # [cycles] of the NCO
MONUMENT = ecef_from_geodetic([0.6, 2.4, 50.0])
OFFSET = np.array([3.0, -1.0, 2.0])  # [m] east, north, up of all solutions
LOCKED, GAP = 1 | 2 | 4 | 8, 256


def zero(kind):
    """What a field holds where no value is given, and the type of its elements."""
    form, detail = kind
    if form.name == "BASE":
        return ("" if detail[0] == "string" else 0), None
    if form.name == "NAME":
        return None, None
    element, size = detail[0][1][0], detail[1]
    if element == "string":
        return [], None
    return np.zeros(size if form.name == "ARRAY" else 1, element), element


FIELDS = {
    kind: {field: zero(what) for field, what in STORE.fielddefs[kind][1]}
    for kind in (f"deepseis_msgs/msg/{name}" for name in ("TrackingEpochs", "Pvt"))
}


def put(bag, topic, kind, stamp_ns, **given):
    time_type = STORE.types["builtin_interfaces/msg/Time"]
    stamp = time_type(sec=int(stamp_ns // 10**9), nanosec=int(stamp_ns % 10**9))
    values = {"header": STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")}
    for field, (default, element) in FIELDS[kind].items():
        if field != "header":
            value = given.get(field, default)
            values[field] = value if element is None else np.asarray(value, element)
    cdr = STORE.serialize_cdr(STORE.types[kind](**values), kind)
    bag.write(topic, kind, bytes(cdr), stamp_ns, stamp_ns)


def true_phase(satellite, t):
    return (500.0 + 300.0 * SATELLITES.index(satellite)) * t


def write_tracking(bag, noise, gap_s=None):
    for k in range(int(SECONDS * RATE / BLOCK)):
        stamp, sample, t = START_NS + k * 20_000_000, k * BLOCK, k * BLOCK / RATE
        clock = 40.0 * t + 3.0 * np.sin(t)  # [cycles] common to all: the receiver's oscillator
        for satellite in SATELLITES:
            own = noise.normal(0.0, NOISE[satellite])
            one = {
                "sample_index": [sample],
                "sample_count": [BLOCK],
                "carrier_phase_cycles": [true_phase(satellite, t) + clock + own],
                "carrier_doppler_hz": [true_phase(satellite, 1.0) + 40.0 + 3.0 * np.cos(t)],
                "prompt_i": [20.0],
                "early_i": [15.0],
                "late_i": [15.0],
                "carrier_error_cycles": [own],
                "code_error_chips": [0.01],
                "cn0_dbhz": [42.0],
                "phase_lock_indicator": [1.0],
                "aid_doppler_hz": [np.nan],
                "flags": [(LOCKED if t >= 1.0 else 1) | (GAP if t == gap_s else 0)],
            }
            put(
                bag,
                f"/tracking/{satellite}/epochs",
                "deepseis_msgs/msg/TrackingEpochs",
                stamp,
                satellite=satellite,
                block_sample_index=sample,
                valid_through=sample + BLOCK - 1,
                mode=3 if t >= 1.0 else 1,
                **one,
            )


def write_solutions(bag, noise):
    for k in range(int((SECONDS - FIRST_FIX) * 10)):
        t = FIRST_FIX + k / 10
        enu = OFFSET + noise.normal(0.0, 0.1, 3)
        put(
            bag,
            "/gnss/pvt",
            "deepseis_msgs/msg/Pvt",
            START_NS + int(t * 1e9),
            sample_index=int(t * RATE),
            week=2300,
            tow_ns=int(t * 1e9),
            status=1,
            position_ecef=ecef_from_enu(enu, MONUMENT),
            position_covariance_ecef=np.eye(3).ravel(),
            velocity_covariance_ecef=np.eye(3).ravel(),
            satellites=list(SATELLITES),
            pseudorange_residual=np.full(5, 0.5),
            range_rate_residual=np.zeros(5),
            elevation=np.full(5, 0.7),
            azimuth=np.arange(5.0),
            pdop=2.0,
        )


@pytest.fixture(scope="module")
def make_run(tmp_path_factory):
    def make(fixed=True, gap_s=None):
        folder, noise = tmp_path_factory.mktemp("run"), np.random.default_rng(1)
        with BagWriter(folder / "bag", definitions=Definitions(TEXTS)) as bag:
            write_tracking(bag, noise, gap_s)
            if fixed:
                write_solutions(bag, noise)
        t = np.arange(0.0, SECONDS, 0.01)
        np.savez(
            folder / "truth.npz",
            t_s=t,
            prn=[int(s[1:]) for s in SATELLITES],
            carrier_phase_cycles=np.stack([true_phase(s, t) for s in SATELLITES], axis=1),
            antenna_ecef=np.broadcast_to(MONUMENT, (t.size, 3)),
        )
        return folder

    return make


@pytest.fixture(scope="module")
def run(make_run):
    return make_run()


@pytest.fixture(scope="module")
def written(run):
    extra = {"real_time_factor": 7.5, "versions": {"numpy": "2"}, "input_sha256": "ab" * 32}
    return report.write_report(run, truth=run / "truth.npz", title="A <test>", extra=extra)


def test_columns_hold_what_the_messages_said(run):
    data = RunData.read(run)
    count = int(SECONDS * RATE / BLOCK)
    track = data.tracking["G07"]
    assert data.satellites == list(SATELLITES)
    assert data.sample_rate_hz == RATE  # from the stamps: no IF in this bag
    assert data.start_utc_ns == START_NS
    assert data.duration == SECONDS
    assert_array_equal(track["sample_index"], np.arange(count) * BLOCK)
    assert_array_equal(track.per_row("mode"), track["mode"])
    assert data.pvt["position_ecef"].shape == (40, 3)
    assert_array_equal(data.pvt["row"], np.repeat(np.arange(40), 5))


def test_position_error_is_the_offset_from_the_truth(written):
    # 40 epochs of 0.1 m noise: the mean is good to 4 * 0.1 / sqrt(40) m
    assert_allclose(written["position_error_m"], np.linalg.norm(OFFSET), atol=0.064)
    assert_allclose(written["position_error_east_m"], OFFSET[0], atol=0.064)
    assert_allclose(written["position_error_up_m"], OFFSET[2], atol=0.064)
    assert written["time_to_first_fix_s"] == FIRST_FIX


def test_true_phase_error_is_each_loops_own_noise_without_the_clock(run):
    limits = {s: 360 * v for s, v in NOISE.items()}
    found = phase_errors(RunData.read(run), Truth.read(run / "truth.npz"), limits)
    integrations = np.isfinite(found.error_cycles).sum(axis=0).min() / 2
    expected = [NOISE[s] for s in found.satellites]
    assert_allclose(found.rms_cycles(), expected, rtol=4 / np.sqrt(2 * integrations))


def test_common_part_and_constants_of_arcs_are_removed():
    noise, (m, n) = np.random.default_rng(2), (4000, 6)
    own = noise.normal(0.0, 0.01, (m, n))
    arcs = (np.arange(m)[:, None] > noise.integers(500, 3500, n)).astype(np.int64)
    constants = noise.uniform(-50.0, 50.0, (2, n))
    clock = np.cumsum(noise.normal(1.0, 0.3, m))
    error = own + clock[:, None] + np.take_along_axis(constants, arcs, axis=0)
    left = remove_common(error, arcs, np.ones(n))
    rms = np.sqrt((left**2).mean(axis=0) / (1 - 1 / n))
    assert_allclose(rms, 0.01, rtol=4 / np.sqrt(2 * m))


def test_summary_is_flat_json_with_numbers(run, written):
    stored = json.loads((run / "summary.json").read_text())
    assert stored == written
    assert stored["real_time_factor"] == 7.5
    assert stored["versions.numpy"] == "2"
    assert stored["satellites_tracked"] == 5
    assert stored["slips"] == 0
    assert stored["cn0_mean_dbhz.G11"] == pytest.approx(42.0)
    assert stored["carrier_error_rms_deg.G11"] == pytest.approx(360 * NOISE["G11"], rel=0.2)
    assert not any(isinstance(value, dict) for value in stored.values())


def test_page_stands_alone_and_is_small(run, written):
    html = (run / "report.html").read_text(encoding="utf-8")
    assert len(html.encode()) < 8e6
    own = html.replace(report_document._plotly(), "")
    assert not re.search(r"""(?:src|href)\s*=|@import|url\(|https?://""", own)
    assert "A &lt;test&gt;" in own
    figures = json.loads(own.split('id="figures">')[1].split("</script>")[0])
    assert len(figures) == own.count("data-panel=")
    titles = re.findall("<h3>(.*?)</h3>", own)
    assert {"Sky", "Signal strength", "Prompt correlators", "True phase error"} <= set(titles)
    assert not list(run.glob(".*.part"))


def test_a_run_without_position_says_so(make_run):
    folder = make_run(fixed=False)
    summary = report.write_report(folder, title="no fix")
    assert "position_error_m" not in summary
    assert "time_to_first_fix_s" not in summary
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert "tracked to phase lock; no position." in html
    assert "Horizontal position" not in html


def test_a_gap_without_recorded_samples_is_of_unknown_length(make_run):
    folder = make_run(gap_s=5.0)
    summary = report.write_report(folder, title="gap")
    assert summary["gaps"] == 1
    assert "lost_samples" not in summary
    assert "1 gap" in (folder / "report.html").read_text(encoding="utf-8")


def test_a_run_that_tracked_nothing_has_a_page_too(tmp_path):
    with BagWriter(tmp_path / "bag", definitions=Definitions(TEXTS)) as bag:
        put(bag, "/gnss/pvt", "deepseis_msgs/msg/Pvt", START_NS, satellites=["G01"])
    summary = report.write_report(tmp_path, title="nothing")
    assert summary["satellites_tracked"] == 0
    assert summary["positions"] == 0
    assert "0 satellites tracked" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_bag_cut_short_is_reported_as_far_as_it_goes(make_run):
    folder = make_run()
    bag = next((folder / "bag").glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size * 2 // 3])
    summary = report.summarise(folder)
    assert not summary["bag_is_whole"]


def test_a_wrong_truth_is_named_and_nothing_is_written(make_run, tmp_path):
    folder, wrong = make_run(), tmp_path / "truth.npz"
    wrong.write_text("no archive")
    with pytest.raises(InputError, match=r"truth\.npz: is not a readable"):
        report.write_report(folder, truth=wrong)
    assert not (folder / "report.html").exists()
    assert not (folder / "summary.json").exists()


def test_thinning_keeps_extremes_and_holes():
    t = np.arange(10_000) * 0.02
    y = np.sin(t)
    y[1234], y[8765] = 9.0, -9.0
    thin_t, thin_y = envelope(t, y, 200)
    assert thin_t.size == 200
    assert (thin_y.max(), thin_y.min()) == (9.0, -9.0)
    holed_t, holed_y = with_breaks(np.array([0.0, 0.1, 0.2, 5.0, 5.1]), np.ones(5))
    assert_array_equal(np.isnan(holed_y), [False, False, False, True, False, False])
    assert holed_t.size == 6


def test_states_follow_flags_and_idle_blocks(run):
    columns = RunData.read(run).tracking["G02"]
    sample, state = states(columns)
    assert stretches(sample / RATE, state, SECONDS) == [(PULL_IN, 0.0, 1.0), (PHASE, 1.0, SECONDS)]
    columns["flags"][60:80] = 1 | 4
    columns["mode"][:10] = 0
    sample, state = states(columns)
    assert SEARCH in state
    assert CODE in state
