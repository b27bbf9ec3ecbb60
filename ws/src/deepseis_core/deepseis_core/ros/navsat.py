"""Our position solution as the standard message."""

from __future__ import annotations

import math

import numpy as np
from sensor_msgs.msg import NavSatFix, NavSatStatus

from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.ros.convert import stamp_from_ns
from deepseis_core.types import Pvt, PvtStatus


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
