"""Static frames: from the Earth's centre to the antenna the chain ends where it was surveyed."""

from types import SimpleNamespace

import numpy as np
import pytest
from unit.bringup.test_launch_file import launch_file  # noqa: F401 (a fixture)

from deepseis_bringup.frames import static_transforms
from deepseis_core.geodesy import ecef_from_enu, ecef_from_geodetic
from deepseis_core.rotation import matrix_from_quat, quat_from_rotvec

MONUMENT = ecef_from_geodetic(np.array([np.radians(38.7292), np.radians(141.0217), 40.0]))
FUSION = {
    "monument_ecef": MONUMENT.tolist(),
    "antenna_lever_arm": [0.1, -0.2, 1.5],
    "imu_to_antenna": [0.3, 0.4, 1.1],
    "imu_orientation_xyzw": quat_from_rotvec(np.array([0.1, -0.2, 2.0])).tolist(),
}


def chain(frames, leaf):
    """Where the origin of a frame is in the first one's parent, and its axes there."""
    by_child = {frame.child: frame for frame in frames}
    place, axes = np.zeros(3), np.eye(3)
    while leaf in by_child:
        frame = by_child[leaf]
        C = matrix_from_quat(frame.quat)
        place, axes, leaf = frame.translation + C @ place, C @ axes, frame.parent
    assert leaf == "earth"
    return place, axes


def test_the_antenna_is_where_monument_and_lever_arm_put_it():
    place, _ = chain(static_transforms(FUSION), "gnss_antenna")
    surveyed = ecef_from_enu(np.array(FUSION["antenna_lever_arm"]), MONUMENT)
    np.testing.assert_allclose(place, surveyed, atol=1e-8)


def test_the_map_s_axes_are_east_north_up():
    _, axes = chain(static_transforms(FUSION), "map")
    east = ecef_from_enu(np.array([1.0, 0.0, 0.0]), MONUMENT) - MONUMENT
    np.testing.assert_allclose(axes[:, 0], east, atol=1e-8)
    assert axes[:, 2] @ MONUMENT / np.linalg.norm(MONUMENT) > 0.9999


@pytest.mark.parametrize(("known", "count"), [({}, 0), ({"monument_ecef": MONUMENT}, 1)])
def test_what_is_not_surveyed_has_no_frame(known, count):
    assert len(static_transforms(known)) == count


def test_the_launch_file_publishes_them_where_tf2_is(launch_file, monkeypatch):  # noqa: F811
    packages = "ament_index_python.packages.get_package_prefix"
    assert launch_file.frame_publishers(FUSION, "kobe") == []
    monkeypatch.setattr(packages, lambda name: f"/opt/ros/{name}")
    nodes = launch_file.frame_publishers(FUSION, "kobe")
    assert [n.named["arguments"][-1] for n in nodes] == [
        "map", "base_link", "imu_link", "gnss_antenna",
    ]  # fmt: skip
    assert {n.named["namespace"] for n in nodes} == {"kobe"}
    assert {SimpleNamespace(**n.named).remappings[0] for n in nodes} == {
        ("/tf_static", "tf_static")
    }
