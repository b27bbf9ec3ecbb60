"""RTK epoch by epoch: real receivers as `rnx2rtkp` solves them, and 50 Hz of simulated ones."""

from collections import Counter

import numpy as np
import pyrtklib as rtklib
import pytest
from numpy.testing import assert_allclose

from deepseis_core.ephemeris import pack, satellite_states
from deepseis_core.errors import InputError
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import PreciseStatus
from deepseis_pvt.rtk import solve_files
from deepseis_pvt.rtklib_values import Navigation, gpst, satellite_name


def postpos(rover, base, navigation, base_position, out):
    """Solve by RTKLIB's file loop, as ``rnx2rtkp`` does; return fixed and all, and positions."""
    options = rtklib.prcopt_default
    options.mode, options.navsys, options.nf = rtklib.PMODE_KINEMA, rtklib.SYS_GPS, 2
    options.elmin, options.refpos = np.radians(15.0), 0
    # RTKLIB's defaults, for they are one object for all who ask, and other tests set them.
    options.modear, options.thresar[0] = 1, 3.0
    options.ionoopt, options.tropopt = rtklib.IONOOPT_OFF, rtklib.TROPOPT_OFF
    options.err[0], options.err[1], options.err[2] = 100.0, 0.003, 0.003
    for i in range(3):
        options.eratio[i], options.std[i] = (100.0, 100.0, 0.0)[i], (30.0, 0.03, 0.3)[i]
        options.rb[i] = float(base_position[i])
    solution = rtklib.solopt_default
    solution.posf = rtklib.SOLF_XYZ
    zero, files = rtklib.gtime_t(), [str(path) for path in (rover, base, *navigation)]
    name = rtklib.Arr1Dchar(len(str(out)) + 1)
    for place, letter in enumerate(str(out) + "\0"):
        name[place] = letter
    rtklib.postpos(
        zero, zero, 0.0, 0.0, options, solution, rtklib.filopt_t(), files, len(files),
        name, "", "",
    )  # fmt: skip
    rows = [line.split() for line in out.read_text().splitlines() if line[:1] not in "%"]
    return np.array([[float(x) for x in row[2:6]] for row in rows])


@pytest.mark.parametrize(
    ("folder", "rover", "base", "navigation", "fixed"),
    [
        (
            "rtklib_geonet_3km_30s",
            "07590920.05o",
            "30400920.05o",
            ["07590920.05n", "30400920.05n"],
            115,
        ),
        ("cssrlib_5km_1hz", "SEPT265G.21O", "3034265G.21O", ["SEPT2650.21P"], 131),
    ],
)
def test_real_pairs_are_fixed_as_rnx2rtkp_fixes_them(
    shared_data, tmp_path, folder, rover, base, navigation, fixed
):
    home = shared_data / "rinex" / folder
    files = home / rover, home / base, [home / name for name in navigation]
    ours = [e.solution for e in solve_files(*files) if e.solution is not None]
    found = Counter(s.status for s in ours)
    # What rnx2rtkp fixes by its defaults; it averages single points for the base's place, which
    # moves a ratio near 3 in some epochs of the second pair.
    assert abs(found[PreciseStatus.FIX] - fixed) <= (0 if fixed == 115 else 5)
    text = files[1].read_text().splitlines()
    header = next(line for line in text if "APPROX POSITION XYZ" in line)
    position = [float(x) for x in header[:60].split()]
    theirs = postpos(*files, position, tmp_path / "out.pos")
    theirs = theirs[theirs[:, 3] <= 2]
    assert len(theirs) == len(ours)
    assert [int(s.status) for s in ours] == [4 if q == 1 else 3 for q in theirs[:, 3]]
    # The same code on the same data: what remains is the text's last digit.
    assert_allclose([s.position_ecef for s in ours], theirs[:, :3], rtol=0, atol=1e-4)


def test_orbits_are_the_same_to_rtklib(shared_data):
    home = shared_data / "rinex" / "rtklib_geonet_3km_30s"
    file = read_rinex_nav(home / "07590920.05n")
    navigation = Navigation()
    values = file.ephemerides
    navigation.set(values, np.arange(8.0))
    position, clock, variance = rtklib.Arr1Ddouble(3), rtklib.Arr1Ddouble(1), rtklib.Arr1Ddouble(1)
    for place, value in enumerate(values):
        assert satellite_name(navigation.nav.eph[place].sat) == value.satellite
        tow = value.toe + 1234.5
        rtklib.eph2pos(gpst(value.week, tow), navigation.nav.eph[place], position, clock, variance)
        ours = satellite_states(pack([value]), value.week, round(tow * 1e9), np.zeros(1))[0]
        assert_allclose([position[i] for i in range(3)], ours[:3], rtol=0, atol=1e-5)
        assert_allclose(clock[0] - value.tgd, ours[9], rtol=0, atol=1e-14)
    assert [navigation.nav.ion_gps[i] for i in range(8)] == list(range(8))


def test_files_that_do_not_serve_are_named(tmp_path):
    empty = tmp_path / "empty.rnx"
    empty.write_text("nothing\n")
    with pytest.raises(InputError, match=r"gone\.rnx: does not exist"):
        next(solve_files(empty, empty, [tmp_path / "gone.rnx"]))
    with pytest.raises(InputError, match="holds no orbits"):
        next(solve_files(empty, empty, [empty]))
