"""The inertial solution as the standard message."""

from __future__ import annotations

import numpy as np
from nav_msgs.msg import Odometry

from deepseis_core.ros.convert import stamp_from_ns
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.types import InsSolution

_ENU_FROM_NED = np.array([1, 0, 2])


def odometry_from_solution(solution: InsSolution, utc_ns: int) -> Odometry:
    """Return the last epoch: pose in ENU at the monument, twist in the body (REP-105, REP-103).

    Covariances hold variances of position, attitude and velocity about east, north, up; angular
    velocity is not in a solution, its variance is -1.
    """
    msg = Odometry()
    msg.header.stamp = stamp_from_ns(utc_ns)
    msg.header.frame_id, msg.child_frame_id = "map", solution.child_frame_id
    position, quat = solution.position_enu[-1], solution.orientation_xyzw[-1]
    pose, twist = msg.pose.pose, msg.twist.twist
    pose.position.x, pose.position.y, pose.position.z = (float(v) for v in position)
    q = pose.orientation
    q.x, q.y, q.z, q.w = (float(v) for v in quat)
    velocity = matrix_from_quat(quat).T @ solution.velocity_enu[-1]
    twist.linear.x, twist.linear.y, twist.linear.z = (float(v) for v in velocity)
    variance = np.asarray(solution.state_sd[-1], np.float64) ** 2
    position_v, velocity_v, attitude_v = (variance[k : k + 3][_ENU_FROM_NED] for k in (0, 3, 6))
    msg.pose.covariance = np.diag(np.concatenate([position_v, attitude_v])).ravel()
    msg.twist.covariance = np.diag(np.concatenate([velocity_v, np.full(3, -1.0)])).ravel()
    return msg
