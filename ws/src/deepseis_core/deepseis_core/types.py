"""Values that cross package borders. Frozen; field names are those of the messages.

Arrays within one value are aligned on their first axis. Sample indices count IF samples from
the start of the recording and are the station's clock (docs/conventions.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]


class TrackingMode(IntEnum):
    """What a channel is doing."""

    IDLE = 0
    PULL_IN = 1
    BIT_SYNC = 2
    TRACK = 3
    TRACK_AIDED = 4


class TrackingFlag(IntFlag):
    """What is known about one integration."""

    CODE_LOCK = 1
    PHASE_LOCK = 2
    BIT_SYNC = 4
    POLARITY_KNOWN = 8
    SLIP = 16
    HALF_CYCLE = 32
    AID_MISSED = 64
    AID_DIVERGED = 128
    GAP = 256


class Lli(IntFlag):
    """RINEX loss-of-lock indicator bits."""

    SLIP = 1
    HALF_CYCLE = 2


class PvtStatus(IntEnum):
    """Kind of position solution."""

    NONE = 0
    SINGLE = 1
    FLOAT = 2
    FIX = 3


@dataclass(frozen=True)
class IfBlock:
    """Packed IF samples as the front end gave them."""

    sample_index: int
    sample_count: int
    sample_rate_hz: float
    intermediate_frequency_hz: float
    format: str
    data: NDArray[np.uint8]


@dataclass(frozen=True)
class AcquisitionResult:
    """One satellite found, or searched for in vain (``detected`` False)."""

    satellite: str
    detected: bool
    sample_index: int
    effective_sample_index: int
    code_phase_chips: float
    carrier_doppler_hz: float
    doppler_sd_hz: float
    statistic: float
    threshold: float
    false_alarm_probability: float
    cn0_dbhz: float


@dataclass(frozen=True)
class TrackingEpochs:
    """Integrations of one satellite that ended within one IF block.

    The carrier NCO, ``tau`` seconds after an integration's first sample::

        phase = carrier_phase_cycles + doppler*tau + doppler_rate*tau**2/2 + doppler_accel*tau**3/3

    ``transmit_ms`` is the GPS millisecond of week at which the code period holding the first
    sample was transmitted (-1 unknown), ``code_phase_chips`` the replica's phase in that period.
    """

    satellite: str
    block_sample_index: int
    valid_through: int
    ephemeris_count: int
    mode: int
    sample_index: IntArray
    sample_count: NDArray[np.int32]
    transmit_ms: IntArray
    code_phase_chips: FloatArray
    code_rate_cps: FloatArray
    carrier_phase_cycles: FloatArray
    carrier_doppler_hz: FloatArray
    carrier_doppler_rate: FloatArray
    carrier_doppler_accel: FloatArray
    early_i: Float32Array
    early_q: Float32Array
    prompt_i: Float32Array
    prompt_q: Float32Array
    late_i: Float32Array
    late_q: Float32Array
    carrier_error_cycles: Float32Array
    code_error_chips: Float32Array
    cn0_dbhz: Float32Array
    phase_lock_indicator: Float32Array
    aid_doppler_hz: Float32Array
    aid_age_s: Float32Array
    flags: NDArray[np.uint16]


@dataclass(frozen=True)
class Ephemeris:
    """GPS LNAV broadcast ephemeris, SI units and radians (IS-GPS-200, tables 20-I to 20-III)."""

    satellite: str
    week: int
    toe: float
    toc: float
    af0: float
    af1: float
    af2: float
    tgd: float
    sqrt_a: float
    eccentricity: float
    i0: float
    omega0: float
    omega: float
    m0: float
    delta_n: float
    omega_dot: float
    i_dot: float
    cuc: float
    cus: float
    crc: float
    crs: float
    cic: float
    cis: float
    iode: int = 0
    iodc: int = 0
    health: int = 0
    accuracy: float = 2.0
    l2_code: int = 0
    l2p_flag: int = 0
    fit_interval_flag: int = 0
    transmit_tow: float = 0.0
    effective_sample_index: int = -1
    iono_alpha: tuple[float, ...] = ()
    iono_beta: tuple[float, ...] = ()


@dataclass(frozen=True)
class Observations:
    """One epoch on the GPS-time grid; arrays are aligned on ``satellites``."""

    sample_index: int
    sample_fraction: float
    week: int
    tow_ns: int
    valid_through: int
    interval: float
    satellites: tuple[str, ...]
    pseudorange: FloatArray
    carrier_phase_cycles: FloatArray
    carrier_doppler_hz: FloatArray
    cn0_dbhz: Float32Array
    lli: NDArray[np.uint8]
    lock_time: Float32Array
    carrier_error_cycles: Float32Array
    carrier_error_sd_cycles: Float32Array
    code_error_chips: Float32Array
    code_error_sd_chips: Float32Array
    flags: NDArray[np.uint16]


def _empty() -> Float32Array:
    return np.zeros(0, np.float32)


def _no_covariance() -> FloatArray:
    return np.zeros(9)


def _no_vector() -> FloatArray:
    return np.full(3, np.nan)


@dataclass(frozen=True)
class Pvt:
    """Position, velocity and clock of one epoch, ECEF; residuals aligned on ``satellites``."""

    sample_index: int
    week: int
    tow_ns: int
    valid_through: int
    status: int
    position_ecef: FloatArray
    velocity_ecef: FloatArray
    clock_bias: float
    clock_drift: float
    position_covariance_ecef: FloatArray
    velocity_covariance_ecef: FloatArray
    satellites: tuple[str, ...] = ()
    pseudorange_residual: Float32Array = field(default_factory=_empty)
    range_rate_residual: Float32Array = field(default_factory=_empty)
    elevation: Float32Array = field(default_factory=_empty)
    azimuth: Float32Array = field(default_factory=_empty)
    gdop: float = float("nan")
    pdop: float = float("nan")
    hdop: float = float("nan")
    vdop: float = float("nan")
    rejected: tuple[str, ...] = ()


class PreciseStatus(IntEnum):
    """Kind of a position from carrier phases."""

    NONE = 0
    CALIBRATING = 1
    PHASE = 2
    FLOAT = 3
    FIX = 4


@dataclass(frozen=True)
class PrecisePosition:
    """Antenna from carrier phases, one epoch; the fields of ``PrecisePosition.msg``.

    ``displacement_enu`` [m] is from the surveyed place, east, north, up there;
    ``common_covariance_enu`` is the part of its covariance that neighbouring epochs share. With a
    ``datum`` other than 0 it is from a place that is not known, the same for all of that datum.
    ``loops_displacement_enu`` is by the loops' own phases, where the former is by others.
    """

    sample_index: int
    week: int
    tow_ns: int
    valid_through: int
    method: str
    status: int
    displacement_enu: FloatArray
    covariance_enu: FloatArray
    clock_bias: float
    clock_bias_sd: float
    common_covariance_enu: FloatArray = field(default_factory=_no_covariance)
    satellites: tuple[str, ...] = ()
    phase_residual: Float32Array = field(default_factory=_empty)
    rejected: tuple[str, ...] = ()
    ratio: float = float("nan")
    base_age: float = float("nan")
    datum: int = 0
    loops_displacement_enu: FloatArray = field(default_factory=_no_vector)
    loops_sd_enu: FloatArray = field(default_factory=_no_vector)


class DisplacementSource(IntEnum):
    """What a ground motion is from."""

    GNSS = 0
    AIDED = 1
    FUSED = 2


@dataclass(frozen=True)
class Displacement:
    """Ground motion at n epochs, east north up, (n, 3) each; fields of ``Displacement.msg``."""

    source: int
    smoothed: bool
    valid_through: int
    interval: float
    tow_ns: IntArray
    week: int
    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    displacement_sd: Float32Array
    velocity_sd: Float32Array
    acceleration_sd: Float32Array


@dataclass(frozen=True)
class Stamp:
    """A time as ROS has it: UTC since 1970 [s, ns]."""

    sec: int
    nanosec: int


@dataclass(frozen=True)
class SeismicEvent:
    """What is known of an event; the fields of ``SeismicEvent.msg``. Peaks are of vectors."""

    event_id: str
    onset: Stamp
    ended: bool
    onset_ratio: float
    peak_displacement: float
    peak_velocity: float
    peak_acceleration: float
    hypocentral_distance: float = float("nan")
    magnitude: float = float("nan")
    magnitude_sd: float = float("nan")


@dataclass(frozen=True)
class Aiding:
    """Predicted Doppler over ``[valid_from, valid_through]`` at uniform knots.

    ``carrier_doppler_hz`` and ``carrier_doppler_rate`` have shape (n_satellites, knot_count);
    the receiver oscillator's part is ``clock_drift_hz`` (NaN: unknown, the loop keeps its own).
    """

    source: str
    valid_from: int
    valid_through: int
    valid: bool
    knot_sample_index: int
    knot_step_samples: int
    knot_count: int
    satellites: tuple[str, ...]
    carrier_doppler_hz: FloatArray
    carrier_doppler_rate: FloatArray
    clock_drift_hz: float
    doppler_sd_hz: Float32Array


@dataclass(frozen=True)
class ImuSample:
    """Mean rates of an IMU over an interval, body axes forward-left-up (REP-145).

    Times the interval they are the increments of angle and velocity; ``sample_index`` is the
    last whole sample at or before the interval's end, the time of validity. Variances of one
    axis; -1: the sensor has no such axes.
    """

    sample_index: int
    angular_velocity: FloatArray
    linear_acceleration: FloatArray
    angular_velocity_variance: float
    linear_acceleration_variance: float


@dataclass(frozen=True)
class Station:
    """What the station is and where its sensors sit; the fields of ``Station.msg``."""

    name: str
    network: str
    monument_ecef: FloatArray
    antenna_lever_arm: FloatArray
    imu_to_antenna: FloatArray
    imu_orientation_xyzw: FloatArray
    receiver: str = ""
    receiver_serial: str = ""
    antenna: str = ""
    antenna_serial: str = ""
    imu: str = ""
    imu_serial: str = ""


@dataclass(frozen=True)
class LdvVelocity:
    """One measurement of a two-beam laser velocimeter; the fields of ``LdvVelocity.msg``."""

    sample_index: int
    valid_through: int
    beam_velocity: FloatArray
    beam_elevation: FloatArray
    forward_velocity: float
    vertical_velocity: float
    beam_velocity_sd: Float32Array
    quality: float


@dataclass(frozen=True)
class Truth:
    """What the simulator knows: n epochs of motion, m of k satellites (``Truth.msg``)."""

    valid_through: int
    sample_index: IntArray
    position_ecef: FloatArray
    velocity_ecef: FloatArray
    acceleration_ecef: FloatArray
    orientation_xyzw: FloatArray
    satellite_sample_index: IntArray
    satellites: tuple[str, ...]
    range: FloatArray
    pseudorange: FloatArray
    carrier_phase_cycles: FloatArray
    carrier_doppler_hz: FloatArray
    cn0_dbhz: Float32Array
    clock_bias: FloatArray


class InsFilter(IntEnum):
    """Which filter an inertial solution is from."""

    LOOSE = 0
    TIGHT = 1
    GYRO_FREE = 2
    LDV = 3


@dataclass(frozen=True)
class InsSolution:
    """Inertial solution at n epochs, m measurement updates; fields of ``InsSolution.msg``.

    Vectors have shape (n, 3), quaternions (n, 4), ``state_sd`` (n, state_count), innovations
    (m, innovation_size); clocks have n values or none.
    """

    child_frame_id: str
    filter: int
    smoothed: bool
    valid_through: int
    sample_index: IntArray
    tow_ns: IntArray
    week: int
    position_enu: FloatArray
    velocity_enu: FloatArray
    orientation_xyzw: FloatArray
    acceleration_enu: FloatArray
    gyro_bias: FloatArray
    accelerometer_bias: FloatArray
    clock_bias: FloatArray
    clock_drift: FloatArray
    state_sd: Float32Array
    state_count: int
    innovation_sample_index: IntArray
    innovation: Float32Array
    innovation_sd: Float32Array
    innovation_size: int
    innovation_accepted: NDArray[np.bool_]


class MotionKind(IntEnum):
    """Whether a station is still."""

    UNKNOWN = 0
    STATIC = 1
    MOVING = 2


@dataclass(frozen=True)
class MotionState:
    """Decision on still or moving; fields of ``MotionState.msg``.

    The state holds from ``sample_index`` on, which may lie before the decision, and is decided
    through ``valid_through``. Variances of gyros and accelerometers, x y z, forward-left-up.
    """

    sample_index: int
    valid_through: int
    state: int
    policy: str
    variance: Float32Array
    threshold: Float32Array
