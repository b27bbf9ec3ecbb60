import datetime as dt
from dataclasses import replace

import georinex
import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.pvt.rtklib_reference import epochs as rtklib_epochs
from unit.pvt.test_pvt_engine import engine, run
from unit.pvt.tracked_signals import KLOBUCHAR, TOW, WEEK, ephemeris, visible

from deepseis_core.errors import InputError
from deepseis_core.rinex_nav import write_rinex_nav
from deepseis_core.types import PvtStatus
from deepseis_pvt.rinex_obs import RinexObsWriter, RinexStation
from deepseis_pvt.spp import SppConfig

LABELS = (
    "RINEX VERSION / TYPE",
    "PGM / RUN BY / DATE",
    "MARKER NAME",
    "OBSERVER / AGENCY",
    "REC # / TYPE / VERS",
    "ANT # / TYPE",
    "APPROX POSITION XYZ",
    "ANTENNA: DELTA H/E/N",
    "SYS / # / OBS TYPES",
    "INTERVAL",
    "TIME OF FIRST OBS",
    "SYS / PHASE SHIFT",
    "END OF HEADER",
)


@pytest.fixture(params=[50, 100])
def recorded(request, moving, tmp_path):
    """Return epochs of the moving antenna at 50 and 100 Hz, and their RINEX files."""
    spp = SppConfig(floor_sd=0.3 * 2**0.5, code_sd=0.3)
    made = engine(rate_hz=request.param, spp=spp, pvt_rate_hz=50)
    made.push_klobuchar(KLOBUCHAR[:4], KLOBUCHAR[4:])
    done = run(made, moving)
    with RinexObsWriter(tmp_path) as writer:
        for observations, pvt in done:
            writer.write(observations, None if pvt is None else pvt.position_ecef)
    nav = tmp_path / "brdc.rnx"
    write_rinex_nav(
        nav,
        [ephemeris(int(n[1:])) for n in visible()],
        iono_alpha=tuple(KLOBUCHAR[:4]),
        iono_beta=tuple(KLOBUCHAR[4:]),
    )
    return done, writer.path, nav


def test_rtklib_reads_every_epoch_and_finds_the_same_positions(recorded):
    done, obs, nav = recorded
    read = list(rtklib_epochs(obs, nav))
    assert len(read) == len(done)
    compared = 0
    for (o, pvt), theirs in zip(done, read, strict=True):
        assert_allclose(theirs.tow, o.tow_ns / 1e9, rtol=0, atol=1e-9)
        for k, name in enumerate(o.satellites):
            code, phase, doppler, cn0, lli = theirs.values[name]
            # Half the last digit printed; RTKLIB keeps Doppler in single precision.
            assert_allclose(code, o.pseudorange[k], rtol=0, atol=0.00051)
            assert_allclose(phase, o.carrier_phase_cycles[k], rtol=0, atol=0.00051)
            assert_allclose(doppler, o.carrier_doppler_hz[k], rtol=1e-7, atol=0.00051)
            assert_allclose(cn0, o.cn0_dbhz[k], rtol=0, atol=0.001)
            assert lli == o.lli[k]
        if pvt is None or pvt.status == PvtStatus.NONE:
            continue
        compared += 1
        # Half a millimetre of rounding times PDOP 2, Sagnac to first order 0.3 mm.
        assert_allclose(theirs.position_ecef, pvt.position_ecef, rtol=0, atol=0.002)
        assert_allclose(theirs.clock_bias, pvt.clock_bias, rtol=0, atol=0.002)
    assert compared >= 50


def test_georinex_reads_every_epoch(recorded):
    done, obs, _ = recorded
    data = georinex.load(obs, use="G")
    assert data.sizes["time"] == len(done)
    ns = (data.time.values - np.datetime64("1980-01-06")) // np.timedelta64(1, "ns")
    # georinex cuts the seconds, a double, to whole microseconds.
    late = np.array([o.week * 604800 * 10**9 + o.tow_ns for o, _ in done]) - ns
    assert set(late) <= {0, 1000}
    for name in visible():
        code = [o.pseudorange[o.satellites.index(name)] for o, _ in done]
        assert_allclose(data["C1C"].sel(sv=name).values, code, rtol=0, atol=0.00051)


def test_phase_stays_continuous_to_a_thousandth_of_a_cycle_in_the_file(recorded):
    done, obs, _ = recorded
    name, interval = visible()[0], done[0][0].interval
    data = georinex.load(obs, use="G").sel(sv=name)
    phase, doppler = data["L1C"].values, data["D1C"].values
    # Simpson over two intervals; 5th derivative 0.12 (4 pi)^5 / 0.19 h^5 / 90.
    step = phase[2:] - phase[:-2]
    integral = -interval / 3 * (doppler[:-2] + 4 * doppler[1:-1] + doppler[2:])
    assert np.max(np.abs(step - integral)) < 0.001 + 2.2e3 * interval**5 * 100


def test_every_mandatory_header_line_is_there(recorded):
    done, obs, _ = recorded
    header = obs.read_text().split("END OF HEADER")[0].splitlines()
    labels = [line[60:].strip() for line in header] + ["END OF HEADER"]
    assert set(LABELS) <= set(labels)
    assert all(len(line) <= 80 for line in header)
    by_label = dict(zip(labels, header, strict=False))
    assert float(by_label["INTERVAL"][:10]) == done[0][0].interval
    first = np.array(by_label["TIME OF FIRST OBS"][:43].split(), float)
    assert first[:5].tolist() == [2022, 1, 1, 2, 0]
    assert_allclose(first[5], done[0][0].tow_ns / 1e9 - TOW + 18, atol=1e-9)
    solved = next(pvt for _, pvt in done if pvt is not None)
    position = np.array(by_label["APPROX POSITION XYZ"][:60].split(), float)
    assert_allclose(position, solved.position_ecef, atol=0.001)


def test_the_name_tells_station_start_period_and_rate(recorded):
    done, obs, _ = recorded
    rate = {0.02: "50Z", 0.01: "01C"}[done[0][0].interval]
    assert obs.name == f"DSEI00XXX_R_20220010200_01M_{rate}_GO.rnx"
    assert not list(obs.parent.glob("*.part"))


def epoch_at(observations, tow_ns, satellites=None):
    """Return an epoch moved in time, with as many satellites."""
    moved = replace(observations, week=WEEK, tow_ns=tow_ns)
    if satellites == 0:
        empty = {
            name: value[:0] for name, value in vars(moved).items() if isinstance(value, np.ndarray)
        }
        moved = replace(moved, satellites=(), **empty)
    return moved


def test_a_killed_writer_leaves_all_but_the_last_second(still, tmp_path):
    first = run(engine(), still)[0][0]
    writer = RinexObsWriter(tmp_path)
    for k in range(175):
        writer.write(epoch_at(first, TOW * 10**9 + k * 20_000_000))
    left = next(tmp_path.glob("*.part")).read_text()
    assert left.count("\n>") >= 150
    assert left.endswith("\n")
    writer.close()


def test_seconds_never_round_to_sixty(still, tmp_path):
    first = run(engine(), still)[0][0]
    with RinexObsWriter(tmp_path) as writer:
        writer.write(epoch_at(first, (TOW + 41) * 10**9 + 999_999_960))
        writer.write(epoch_at(first, (TOW + 42) * 10**9))
    lines = [x for x in writer.path.read_text().splitlines() if x.startswith(">")]
    assert lines[0].startswith("> 2022 01 01 02 00 59.9999999  0 10")
    assert lines[1].startswith("> 2022 01 01 02 01  0.0000000  0 10")


def test_an_epoch_without_satellites_is_left_out(still, tmp_path):
    first = run(engine(), still)[0][0]
    with RinexObsWriter(tmp_path) as writer:
        for k, n in enumerate([0, 10, 0, 10]):
            writer.write(epoch_at(first, TOW * 10**9 + k * 20_000_000, n))
    assert writer.path.read_text().count("\n>") == 2
    assert georinex.load(writer.path, use="G").sizes["time"] == 2


def test_the_header_waits_for_a_position(still, tmp_path):
    first = run(engine(), still)[0][0]
    with RinexObsWriter(tmp_path) as writer:
        writer.write(epoch_at(first, TOW * 10**9))
        writer.write(epoch_at(first, TOW * 10**9 + 20_000_000), np.array([1.0, 2.0, 3.0]))
    text = writer.path.read_text()
    assert "        1.0000        2.0000        3.0000                  APPROX POSITION" in text
    assert text.count("\n>") == 2


def test_missing_phase_is_blank(still, tmp_path):
    first = run(engine(), still)[0][0]
    phase = first.carrier_phase_cycles.copy()
    phase[0] = np.nan
    with RinexObsWriter(tmp_path) as writer:
        writer.write(replace(first, carrier_phase_cycles=phase))
    line = next(x for x in writer.path.read_text().splitlines() if x.startswith(visible()[0]))
    assert line[19:35].strip() == ""
    assert float(line[35:49]) == pytest.approx(first.carrier_doppler_hz[0], abs=0.0006)


def test_two_runs_differ_in_the_line_of_the_date_only(still, tmp_path):
    texts = []
    for year in (2022, 2023):
        folder = tmp_path / str(year)
        folder.mkdir()
        writer = RinexObsWriter(folder, created=dt.datetime(year, 1, 1, tzinfo=dt.UTC))
        for observations, _ in run(engine(), still):
            writer.write(observations)
        texts.append(writer.close().read_text().splitlines())
    different = [a for a, b in zip(*texts, strict=True) if a != b]
    assert [line[60:] for line in different] == ["PGM / RUN BY / DATE"]


def test_without_epochs_no_file_appears(tmp_path):
    with RinexObsWriter(tmp_path) as writer:
        pass
    assert writer.close() is None
    assert not list(tmp_path.iterdir())


def test_a_missing_folder_and_a_wrong_name_are_named(tmp_path):
    with pytest.raises(InputError, match="nowhere: is not a folder"):
        RinexObsWriter(tmp_path / "nowhere")
    with pytest.raises(InputError, match="nine letters"):
        RinexStation(name="TOO SHORT")
