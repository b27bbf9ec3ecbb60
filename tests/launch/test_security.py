"""What a node lets in from outside: nothing, and no security that is asked for and not there."""

import os
import signal
import subprocess
import time

import pytest
from domain_coordinator import domain_id
from graph_runs import PROJECT
from sockets import family, internet_addresses

pytestmark = [pytest.mark.launch, pytest.mark.timeout(120)]


def start(folder, **environment):
    """Start a recorder of one topic, as any node."""
    topics = "topics:=['station deepseis_msgs/msg/Station latched']"
    arguments = ["-p", f"directory:={folder}", "-p", topics]
    return subprocess.Popen(
        [PROJECT / "deepseis", "run", "deepseis_bringup", "recorder", "--ros-args", *arguments],
        env={**os.environ, **environment},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def end(process):
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def addresses(process, folder):
    """Addresses of a node's sockets once it records."""
    deadline = time.monotonic() + 60.0
    while not list(folder.glob("*.mcap")):
        assert time.monotonic() < deadline
        assert process.poll() is None, process.communicate()
        time.sleep(0.1)
    time.sleep(1.0)
    return internet_addresses(family(process.pid))


def test_nodes_are_reached_from_this_machine_only_unless_the_network_is_asked_for(tmp_path):
    outside = {"FASTRTPS_DEFAULT_PROFILES_FILE": ""}
    with domain_id() as number:
        common = {**outside, "ROS_DOMAIN_ID": str(number)}
        local = start(tmp_path / "a", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", **common)
        wide = start(tmp_path / "b", ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", **common)
        try:
            assert addresses(local, tmp_path / "a") == {"127.0.0.1"}
            assert "0.0.0.0" in addresses(wide, tmp_path / "b")  # the test sees what is there
        finally:
            end(local)
            end(wide)


def test_security_that_is_enforced_is_never_left_out_in_silence(tmp_path):
    """The wheels' Fast DDS is built without SROS 2: then a node must not start at all."""
    with domain_id() as number:
        (tmp_path / "keys" / "enclaves").mkdir(parents=True)
        process = start(
            tmp_path / "a",
            ROS_DOMAIN_ID=str(number),
            ROS_SECURITY_ENABLE="true",
            ROS_SECURITY_STRATEGY="Enforce",
            ROS_SECURITY_KEYSTORE=str(tmp_path / "keys"),
        )
        try:
            _, said = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            end(process)
            pytest.fail("a node runs unsecured although security is enforced")
    assert process.returncode != 0
    assert not (tmp_path / "a").exists()
    assert "secur" in said.lower() or "enclave" in said.lower()
