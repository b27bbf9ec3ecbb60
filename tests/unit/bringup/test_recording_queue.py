"""Messages of topics that several nodes share: in order of their stamps, whoever comes first."""

import itertools

import pytest

from deepseis_bringup.bags.recording_queue import StampOrder, speaker_of, status_name

STREAM = {
    "pvt": [(10, b"p10"), (20, b"p20"), (30, b"p30")],
    "trackers": [(10, b"t10"), (25, b"t25")],
}
END = 40


def events():
    """Each node's messages and watermarks, in the order in which it publishes them."""
    for member, messages in STREAM.items():
        said = []
        for count, (stamp, data) in enumerate(messages, 1):
            said += [("message", member, stamp, data), ("mark", member, stamp, count)]
        yield [*said, ("mark", member, END, len(messages))]


def arrivals():
    """Every way in which the two nodes' events can arrive, each node's own in order."""
    one, other = events()
    for places in itertools.combinations(range(len(one) + len(other)), len(one)):
        first, second = iter(one), iter(other)
        yield [next(first if k in places else second) for k in range(len(one) + len(other))]


def recorded(arriving):
    order = StampOrder(STREAM)
    found = []
    for kind, member, stamp, what in arriving:
        if kind == "message":
            order.push("/diagnostics", member, stamp, what)
        else:
            order.heard(member, stamp, what)
        found += [data for _, _, data in order.due()]
    return found


def test_the_order_does_not_depend_on_the_arrival():
    expected = [b"p10", b"t10", b"p20", b"t25", b"p30"]
    assert all(recorded(arriving) == expected for arriving in arrivals())


def test_a_watermark_that_overtakes_a_message_waits_for_it():
    order = StampOrder(["pvt", "trackers"])
    order.push("/diagnostics", "trackers", 10, b"t10")
    order.heard("trackers", 15, 1)
    order.heard("pvt", 15, 1)  # its message is still on the way
    assert list(order.due()) == []
    order.push("/diagnostics", "pvt", 5, b"p5")
    assert [data for _, _, data in order.due()] == [b"p5", b"t10"]


def test_a_node_that_hangs_holds_nothing_up_for_longer_than_the_limit():
    order = StampOrder(["pvt", "trackers"], limit_ns=100)
    order.push("/diagnostics", "trackers", 10, b"t10")
    order.heard("trackers", 109, 1)
    assert list(order.due()) == []
    order.heard("trackers", 110, 1)
    assert [data for _, _, data in order.due()] == [b"t10"]


def test_an_ended_node_is_not_waited_for_and_nothing_is_left_behind():
    order = StampOrder(["pvt", "trackers"])
    order.push("/diagnostics", "pvt", 10, b"p10")
    order.heard("pvt", 10, 1)
    order.heard("trackers", 0, 0, ended=True)
    assert [data for _, _, data in order.due()] == [b"p10"]
    order.push("/diagnostics", "pvt", 20, b"p20")
    assert [data for _, _, data in order.due(everything=True)] == [b"p20"]


def test_who_published_is_read_off_the_bytes():
    ros = pytest.importorskip("deepseis_core.ros.diagnostics")
    codecs = pytest.importorskip("deepseis_core.ros.codecs")
    cdr = pytest.importorskip("deepseis_core.ros.cdr")
    status = ros.encoded("pvt", ros.OK, "all is well", {"epochs": 1}, 5)
    request = cdr.encode_message(codecs.acquisition_request("G07", 80_000, 5))
    assert speaker_of(status, ["pvt"]) == "pvt"
    assert speaker_of(request, ["trackers"]) == "trackers"
    assert speaker_of(request, ["trackers_g07"]) == "trackers_g07"


def test_what_others_say_on_diagnostics_is_nobody_s_and_may_be_nothing():
    """A lidar's driver, an updater without tasks: nothing of ours, nothing to stumble over."""
    msg = pytest.importorskip("diagnostic_msgs.msg")
    encode = pytest.importorskip("deepseis_core.ros.cdr").encode_message
    empty = msg.DiagnosticArray()
    empty.header.frame_id = "somewhere"
    for array in (msg.DiagnosticArray(), empty):
        assert (status_name(encode(array)), speaker_of(encode(array), ["pvt"])) == ("", "")
    other = msg.DiagnosticArray(status=[msg.DiagnosticStatus(name="rover/pvt")])
    assert status_name(encode(other)) == "rover/pvt"
    assert speaker_of(encode(other), ["pvt"]) == ""
