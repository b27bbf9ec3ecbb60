import io
from pathlib import Path

import pytest
from rich.console import Console

from deepseis_bringup.bags.info import BagInfo, TopicInfo
from deepseis_bringup.bags.recovery import Loss, Recovery
from deepseis_bringup.bags.text import recovery_lines, show_info, size_text
from deepseis_frontend.if_stream import Remark

START = 1_640_995_200_000_000_000  # 2022-01-01


def bag(**given):
    topics = {
        "/gnss/pvt": TopicInfo(
            "/gnss/pvt", "deepseis_msgs/msg/Pvt", "", 11, START, START + 10**9, 5000
        ),
        "/empty": TopicInfo("/empty", "deepseis_msgs/msg/Ephemeris", ""),
    }
    values = {"topics": topics, "start_ns": START, "end_ns": START + 10**9}
    values["metadata"] = {"deepseis": {"interface_version": "1"}}
    return BagInfo(Path("run/bag"), [Path("run/bag/bag_0.mcap")], 123456, **(values | given))


def shown(info, *, terminal=False, width=120):
    out = io.StringIO()
    show_info(info, Console(file=out, force_terminal=terminal, width=width, color_system=None))
    return out.getvalue()


def test_a_program_gets_columns_with_tabs():
    lines = shown(bag()).splitlines()
    table = [line.split("\t") for line in lines if "\t" in line]
    assert table[0] == ["topic", "type", "messages", "Hz", "first [s]", "last [s]", "MB"]
    assert table[1] == ["/empty", "deepseis_msgs/msg/Ephemeris", "0", "", "", "", "0.000"]
    assert table[2] == [
        *("/gnss/pvt", "deepseis_msgs/msg/Pvt", "11", "10.00", "0.000", "1.000", "0.005")
    ]
    assert "starts 2022-01-01 00:00:00.000 UTC" in lines[1]
    assert "1 MCAP file, 123 kB, 11 messages, 1.000 s" in lines[0]


def test_a_person_gets_a_table():
    text = shown(bag(), terminal=True)
    assert "\t" not in text
    assert "first [s]" in text
    assert all(len(line) <= 120 for line in text.splitlines())


def test_lines_for_programs_are_never_wrapped():
    assert shown(bag(), width=20).splitlines() == shown(bag(), width=200).splitlines()


def test_damage_is_said_with_what_to_do():
    text = shown(
        bag(cut_at=5_000_000, damaged_chunks=2, if_remarks=[Remark("gap", 7, "3 samples missing")])
    )
    assert "CUT SHORT after 5 MB: deepseis recover run/bag" in text
    assert "2 DAMAGED CHUNKS" in text
    assert "3 samples missing" in text
    assert "whole" not in text
    assert "HAS NO INDEX" in shown(bag(has_index=False))
    assert "whole, no samples missing" in shown(bag())


def test_a_foreign_bag_and_an_unset_clock_are_said():
    text = shown(bag(metadata={}, start_ns=5))
    assert "not recorded by DeepSeis" in text
    assert "at an unknown time" in text


def test_recovery_says_what_was_lost():
    whole = Recovery(Path("a"), True, 5, 0, None, 0)
    losses = (Loss("/pvt", 3, START, START + 10**9), Loss("/fix", -1, START, 0))
    cut = Recovery(Path("b"), False, 7, 1, 100, 2500, Path("b.damaged"), losses)
    empty = Recovery(Path("c"), False, 0)
    assert recovery_lines([whole, cut, empty]) == [
        "a: 5 messages, was whole, left as it is",
        "b: 7 messages kept, lost: 2.5 kB at the end and 1 damaged chunks",
        "  /pvt: 3 lost between 2022-01-01 00:00:00.000 UTC and 2022-01-01 00:00:01.000 UTC",
        "  /fix: nothing after 2022-01-01 00:00:00.000 UTC",
        "  the damaged file is b.damaged",
        "c: 0 messages can be read, left as it is (0 B)",
    ]


def test_topics_that_end_together_are_told_in_one_line():
    ends = [Loss(f"/t{k}", -1, START + k * 10**8, 0) for k in range(5)]
    lone, inside = Loss("/station", -1, START - 60 * 10**9, 0), Loss("/pvt", 3, START, START + 1)
    cut = Recovery(Path("b"), False, 7, 0, 100, 0, None, (lone, *ends, inside))
    assert recovery_lines([cut])[1:] == [
        "  5 topics: nothing after 2022-01-01 00:00:00.000 UTC to 2022-01-01 00:00:00.400 UTC",
        "  /station: nothing after 2021-12-31 23:59:00.000 UTC",
        "  /pvt: 3 lost between 2022-01-01 00:00:00.000 UTC and 2022-01-01 00:00:00.000 UTC",
    ]


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (999, "999 B"), (999_600, "1 MB"), (2.5e12, "2.5 TB")]
)
def test_sizes_have_three_digits(count, text):
    assert size_text(count) == text
