"""Grades of inertial measurement units, as data.

What a figure comes from stands beside it:

- [T] the thesis, tables 3.1 and 5.2. Table 3.1 lost a column in print: under the headings
  MTI-G and SPAN-FSAS one column of figures is left. Its ARW, VRW and scale factors (0.1, 0.03,
  300, 300) are those of the maker of the iIMU-FSAS and 30 and 4 times better than an MTi-G's: it
  is the column of the SPAN-FSAS, and that of the MTi-G is lost.
- [H] table 1 of the Hatch-filter paper, [L] section 3 of the SINS/LDV paper, [D] section 3 of the
  Doppler-aided paper, [A] the accelerometer-PPP paper, which names the FSAS manual [4].
- [M] the makers: NovAtel, OEM7 manual, command SETIMUSPECS (iMAR-FSAS: 200 Hz, 1 mg, 0.75 deg/h,
  300 ppm and 300 ppm) and the counts of its log RAWIMU as the GearBox project decodes them;
  Xsens, manual MT0100P of the MTi, whose sensors the MTi-G has (5 g, 300 deg/s, 512 Hz);
  Sensonor, STIM300 data sheet TS1524 (10 g, 400 deg/s, 1 mrad, 1 deg/h/g, 5 deg/h, 0.75 mg).
- [m] a maker's figure from memory, to be looked up where it matters.
- [N] Q. Chen, X. Niu et al., Math. Problems in Engineering 2013, 435286, table 6, of the same
  laboratory: FSAS 0.75 deg/h, 0.1 deg/sqrt(h), 1000 ug, 0.03 m/s/sqrt(h); MTi-G 3600 deg/h,
  3 deg/sqrt(h), 2000 ug, 0.12 m/s/sqrt(h).
- [*] nobody gives it: our choice, of a size usual for the grade.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import inf, pi, radians
from types import MappingProxyType
from typing import Final

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError

STANDARD_GRAVITY: Final = 9.80665
"""[m/s^2] of the unit g in data sheets."""

MGAL: Final = 1e-5
"""[m/s^2]"""

MICRO_G: Final = 1e-6 * STANDARD_GRAVITY
"""[m/s^2]"""

MRAD_DEG: Final = 0.18 / pi
"""[deg]"""


@dataclass(frozen=True)
class TriadGrade:
    """Errors of three gyroscopes or three accelerometers, SI: rad and rad/s, or m/s and m/s^2."""

    bias: float
    instability: float
    correlation_time: float
    walk: float
    scale: float
    misalignment: float
    resolution: float
    range: float
    g_sensitivity: float = 0.0


@dataclass(frozen=True)
class ImuGrade:
    """How good an inertial measurement unit is; 1 sigma wherever something is drawn.

    ``bias`` is that of turn-on, constant in a run; ``instability`` and ``correlation_time`` are
    of a stationary first-order Gauss-Markov process.
    """

    gyro_bias_deg_per_h: float = setting(0.0, "turn-on bias [deg/h]", low=0.0)
    gyro_instability_deg_per_h: float = setting(0.0, "in-run bias [deg/h]", low=0.0)
    gyro_correlation_time: float = setting(3600.0, "of the in-run bias [s]", low=1e-3)
    gyro_walk_deg_per_sqrt_h: float = setting(0.0, "angular random walk [deg/sqrt(h)]", low=0.0)
    gyro_scale_ppm: float = setting(0.0, "scale factor error [ppm]", low=0.0)
    gyro_misalignment_deg: float = setting(0.0, "of each axis towards each other [deg]", low=0.0)
    gyro_resolution_deg: float = setting(0.0, "step of increments, 0: none [deg]", low=0.0)
    gyro_range_deg_per_s: float = setting(inf, "clipping rate [deg/s]", low=0.0)
    gyro_g_sensitivity_deg_per_h: float = setting(
        0.0, "bias per g, each axis on each [deg/h/g]", low=0.0
    )
    accel_bias: float = setting(0.0, "turn-on bias [m/s^2]", low=0.0)
    accel_instability: float = setting(0.0, "in-run bias [m/s^2]", low=0.0)
    accel_correlation_time: float = setting(3600.0, "of the in-run bias [s]", low=1e-3)
    accel_walk_per_sqrt_h: float = setting(0.0, "velocity random walk [m/s/sqrt(h)]", low=0.0)
    accel_scale_ppm: float = setting(0.0, "scale factor error [ppm]", low=0.0)
    accel_misalignment_deg: float = setting(0.0, "of each axis towards each other [deg]", low=0.0)
    accel_resolution: float = setting(0.0, "step of increments, 0: none [m/s]", low=0.0)
    accel_range_g: float = setting(inf, "clipping specific force [g]", low=0.0)
    has_gyros: bool = setting(True, "False: accelerometers only, rates are not a number")
    max_rate_hz: float = setting(1e5, "highest rate of increments [Hz]", low=1.0)

    def __post_init__(self) -> None:
        """Refuse values outside their limits."""
        try:
            check(self)
        except ValueError as error:
            raise InputError("IMU grade", str(error)) from None
        for item in fields(self):
            if getattr(self, item.name) != getattr(self, item.name):
                raise InputError("IMU grade", f"{item.name} is not a number")

    @property
    def gyros(self) -> TriadGrade:
        """Of the gyroscopes [rad, rad/s]; sensitivity to acceleration [rad/s per m/s^2]."""
        per_hour = radians(1.0) / 3600.0
        return TriadGrade(
            bias=self.gyro_bias_deg_per_h * per_hour,
            instability=self.gyro_instability_deg_per_h * per_hour,
            correlation_time=self.gyro_correlation_time,
            walk=radians(self.gyro_walk_deg_per_sqrt_h) / 60.0,
            scale=self.gyro_scale_ppm * 1e-6,
            misalignment=radians(self.gyro_misalignment_deg),
            resolution=radians(self.gyro_resolution_deg),
            range=radians(self.gyro_range_deg_per_s),
            g_sensitivity=self.gyro_g_sensitivity_deg_per_h * per_hour / STANDARD_GRAVITY,
        )

    @property
    def accelerometers(self) -> TriadGrade:
        """Of the accelerometers [m/s, m/s^2]."""
        return TriadGrade(
            bias=self.accel_bias,
            instability=self.accel_instability,
            correlation_time=self.accel_correlation_time,
            walk=self.accel_walk_per_sqrt_h / 60.0,
            scale=self.accel_scale_ppm * 1e-6,
            misalignment=radians(self.accel_misalignment_deg),
            resolution=self.accel_resolution,
            range=self.accel_range_g * STANDARD_GRAVITY,
        )


_SPAN_FSAS = ImuGrade(
    gyro_bias_deg_per_h=0.1,  # [T], what calibration leaves of 0.75 [M, N]
    gyro_instability_deg_per_h=0.1,  # [T]
    gyro_correlation_time=10800.0,  # [T]
    gyro_walk_deg_per_sqrt_h=0.1,  # [T, N]
    gyro_scale_ppm=300.0,  # [T, M]
    gyro_misalignment_deg=0.1 * MRAD_DEG,  # [*]
    gyro_resolution_deg=0.1 / 3600.0,  # [M] a count of log RAWIMU: 0.1 arcsec
    gyro_range_deg_per_s=450.0,  # [m]
    # [T] prints 50 mGal constant and 1000 mGal in-run. The maker's 1 mg (1000 mGal) is the total
    # bias [M, N], and wander 20 times the constant part is no tactical grade: taken as swapped.
    accel_bias=1000.0 * MGAL,
    accel_instability=50.0 * MGAL,
    accel_correlation_time=10800.0,  # [T]
    accel_walk_per_sqrt_h=0.03,  # [T, N]
    accel_scale_ppm=300.0,  # [T, M]
    accel_misalignment_deg=0.1 * MRAD_DEG,  # [*]
    accel_resolution=0.05 / 2**15,  # [M] a count of log RAWIMU
    accel_range_g=5.0,  # [m]
    max_rate_hz=200.0,  # [M]
)

_MTI_G = ImuGrade(
    gyro_bias_deg_per_h=3600.0,  # [N] 1 deg/s
    gyro_instability_deg_per_h=36.0,  # [*] a hundredth of the bias
    gyro_correlation_time=1000.0,  # [*]
    gyro_walk_deg_per_sqrt_h=3.0,  # [N]
    gyro_scale_ppm=1000.0,  # [*] as [T] has for MEMS in table 5.2
    gyro_misalignment_deg=0.1,  # [m]
    gyro_range_deg_per_s=300.0,  # [M]
    accel_bias=2000.0 * MICRO_G,  # [N]
    accel_instability=50.0 * MGAL,  # [*]
    accel_correlation_time=1000.0,  # [*]
    accel_walk_per_sqrt_h=0.12,  # [N]
    accel_scale_ppm=300.0,  # [m] 0.03 %
    accel_misalignment_deg=0.1,  # [m]
    # Increments leave as floating-point numbers; the 16-bit converter's step is below the noise.
    accel_range_g=50.0 / STANDARD_GRAVITY,  # [M]
    max_rate_hz=512.0,  # [M]
)

_STIM300 = ImuGrade(
    gyro_bias_deg_per_h=5.0,  # [M] over static temperature
    gyro_instability_deg_per_h=10.0,  # [T]; the maker's Allan minimum is 0.5
    gyro_correlation_time=60.0,  # [T]
    gyro_walk_deg_per_sqrt_h=0.2,  # [T]; 0.15 [M]
    gyro_scale_ppm=1000.0,  # [T]; 500 [M]
    gyro_misalignment_deg=MRAD_DEG,  # [M] 1 mrad
    gyro_resolution_deg=2.0**-21,  # [m]
    gyro_range_deg_per_s=400.0,  # [M]
    gyro_g_sensitivity_deg_per_h=1.0,  # [M]
    accel_bias=750.0 * MICRO_G,  # [M] on/off
    accel_instability=1000.0 * MGAL,  # [T]; the maker's Allan minimum is 50
    accel_correlation_time=30.0,  # [T]
    accel_walk_per_sqrt_h=0.18,  # [T]; 0.06 [M]
    accel_scale_ppm=1000.0,  # [T]; 300 [M]
    accel_misalignment_deg=MRAD_DEG,  # [M] 1 mrad
    accel_resolution=2.0**-22,  # [m]
    accel_range_g=10.0,  # [M]
    max_rate_hz=2000.0,  # [m]
)

_FOG = ImuGrade(
    gyro_bias_deg_per_h=0.01,  # [H]
    gyro_instability_deg_per_h=0.003,  # [*]
    gyro_walk_deg_per_sqrt_h=0.005,  # [H]
    gyro_scale_ppm=20.0,  # [*]
    gyro_misalignment_deg=0.002,  # [*]
    gyro_resolution_deg=1e-6,  # [*]
    gyro_range_deg_per_s=300.0,  # [*]
    accel_bias=100.0 * MICRO_G,  # [H]
    accel_instability=10.0 * MICRO_G,  # [*]
    accel_walk_per_sqrt_h=60.0 * 200.0 * MICRO_G / 200.0**0.5,  # [H] 200 ug a sample at 200 Hz
    accel_scale_ppm=50.0,  # [*]
    accel_misalignment_deg=0.002,  # [*]
    accel_resolution=1e-6,  # [*]
    accel_range_g=20.0,  # [*]
    max_rate_hz=200.0,  # [H]
)

# [L] gives the accuracy of the sensors, nothing else. Its lines repeat within 0.7 to 1.5 mGal,
# so that the bias, 20 mGal, must be constant on a line to a fraction of that, and 300 s of white
# noise must average out to it.
_NAVIGATION = ImuGrade(
    gyro_bias_deg_per_h=0.003,  # [L]
    gyro_instability_deg_per_h=0.0005,  # [*]
    gyro_walk_deg_per_sqrt_h=0.0005,  # [*]
    gyro_scale_ppm=5.0,  # [*]
    gyro_misalignment_deg=0.001,  # [*]
    gyro_resolution_deg=1e-7,  # [*]
    gyro_range_deg_per_s=300.0,  # [*]
    accel_bias=20.0 * MICRO_G,  # [L]
    accel_instability=0.5 * MGAL,  # [*]
    accel_walk_per_sqrt_h=0.003,  # [*] 5 ug/sqrt(Hz)
    accel_scale_ppm=10.0,  # [*]
    accel_misalignment_deg=0.001,  # [*]
    accel_resolution=1e-7,  # [*]
    accel_range_g=20.0,  # [*]
    max_rate_hz=400.0,  # [*]; the paper's 100 Hz data are within
)

_HIGH_G = ImuGrade(
    gyro_bias_deg_per_h=0.01,  # [D]
    gyro_instability_deg_per_h=0.003,  # [*]
    gyro_walk_deg_per_sqrt_h=0.003,  # [*]
    gyro_scale_ppm=10.0,  # [*]
    gyro_misalignment_deg=0.002,  # [*]
    gyro_resolution_deg=1e-7,  # [*]
    gyro_range_deg_per_s=1000.0,  # [*]
    accel_bias=40.0 * MICRO_G,  # [D]
    accel_instability=10.0 * MICRO_G,  # [*]
    accel_walk_per_sqrt_h=0.01,  # [*]
    accel_scale_ppm=20.0,  # [*]
    accel_misalignment_deg=0.002,  # [*]
    accel_resolution=1e-6,  # [*]
    accel_range_g=80.0,  # [*] above the 50 g of [D] table 2
    max_rate_hz=2000.0,  # [*]
)

GRADES: Final[Mapping[str, ImuGrade]] = MappingProxyType(
    {
        "perfect": ImuGrade(),
        "span-fsas": _SPAN_FSAS,
        "mti-g": _MTI_G,
        "stim300": _STIM300,
        "fog": _FOG,
        "navigation": _NAVIGATION,
        "high-g": _HIGH_G,
        "accelerometers": replace(_SPAN_FSAS, has_gyros=False),  # [A]
    }
)


def grade_named(text: str) -> ImuGrade:
    """Return the grade that a text names, with the changes that it makes.

    A grade of one's own is one of `GRADES` and figures in place of its own, in the units of
    `ImuGrade`: so it travels in messages and bags, and needs no file.

    Parameters
    ----------
    text : str
        A name, or a name and ``figure=value`` for each figure that differs.

    Raises
    ------
    InputError
        The name or a figure is not known, a value is no number or outside its limits.

    Examples
    --------
    >>> grade_named("stim300 accel_walk_per_sqrt_h=0.06 accel_range_g=30").accel_range_g
    30.0
    """
    name, *changes = text.split() or [""]
    what = f"IMU grade {text!r}"
    if name not in GRADES:
        raise InputError(what, "is not known", f"one of {', '.join(GRADES)}")
    values: dict[str, float | bool] = {}
    for change in changes:
        key, separator, value = change.partition("=")
        if not separator or key not in _FIGURES or key in values:
            reason = f"{change!r} is no figure=value, or given twice"
            raise InputError(what, reason, f"figures: {', '.join(_FIGURES)}")
        values[key] = _figure(what, key, value)
    try:
        return replace(GRADES[name], **values)  # type: ignore[arg-type]
    except InputError as error:
        raise InputError(what, error.reason) from None


_FIGURES: Final = tuple(item.name for item in fields(ImuGrade))


def _figure(what: str, key: str, value: str) -> float | bool:
    if key == "has_gyros":
        if value not in ("true", "false"):
            raise InputError(what, f"{key} is {value!r}, neither true nor false")
        return value == "true"
    try:
        return float(value)
    except ValueError:
        raise InputError(what, f"{key} is {value!r}, no number") from None
