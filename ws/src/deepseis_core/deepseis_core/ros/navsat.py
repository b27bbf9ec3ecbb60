"""Our position solution, and the time that it finds, as the standard messages."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from sensor_msgs.msg import NavSatFix, NavSatStatus, TimeReference

from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.ros.convert import stamp_from_ns
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations, Pvt, PvtStatus

TIME_SOURCE: Final = "GPS L1 C/A"


def fix_from_pvt(pvt: Pvt, utc_ns: int) -> NavSatFix:
    """Latitude and longitude [deg], ellipsoidal height [m], covariance east-north-up [m^2]."""
    fix = NavSatFix()
    fix.header.stamp = stamp_from_ns(utc_ns)
    fix.header.frame_id = "gnss_antenna"
    fix.status.service = NavSatStatus.SERVICE_GPS
    if pvt.status == PvtStatus.NONE:
        fix.status.status = NavSatStatus.STATUS_NO_FIX
        fix.latitude = fix.longitude = fix.altitude = math.nan
        return fix
    fix.status.status = NavSatStatus.STATUS_FIX
    lat, lon, height = (float(x) for x in geodetic_from_ecef(np.asarray(pvt.position_ecef)))
    fix.latitude, fix.longitude, fix.altitude = math.degrees(lat), math.degrees(lon), height
    turn = rotation_enu_ecef(lat, lon)
    covariance = np.asarray(pvt.position_covariance_ecef).reshape(3, 3)
    fix.position_covariance = (turn @ covariance @ turn.T).reshape(9)
    fix.position_covariance_type = NavSatFix.COVARIANCE_TYPE_KNOWN
    return fix


def time_reference(
    observations: Observations, pvt: Pvt, clock: SampleClock, utc_ns: int
) -> TimeReference:
    """Say what the station's clock shows (the stamp), and the UTC of then as found from GPS.

    The stamps of samples and IMU are of that clock. Epochs lie on the grid of a receiver clock
    that was set right once; what it is off by since is in the position's ``clock_bias``.

    Parameters
    ----------
    observations : Observations
        Of the epoch, at ``sample_index`` and ``sample_fraction``.
    pvt : Pvt
        Its position.
    clock : SampleClock
        Of the station.
    utc_ns : int
        UTC that the epoch is called by [ns].
    """
    rest_ns = round(1e9 * observations.sample_fraction / clock.sample_rate_hz)
    message = TimeReference(source=TIME_SOURCE)
    message.header.stamp = stamp_from_ns(clock.utc_ns(observations.sample_index) + rest_ns)
    message.time_ref = stamp_from_ns(utc_ns - round(1e9 * pvt.clock_bias / SPEED_OF_LIGHT))
    return message
