from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.yaml_config import fill, overlay, override, parse_yaml


class Shape:
    """What an entry of several kinds is annotated with."""


@dataclass(frozen=True)
class Circle(Shape):
    radius: float = setting(1.0, "radius [m]", low=0.0)


@dataclass(frozen=True)
class Box(Shape):
    sides: tuple[float, float] = setting((1.0, 2.0), "sides [m]", low=0.0)


@dataclass(frozen=True)
class Part:
    rate_hz: float = setting(200.0, "rate [Hz]", low=1.0, high=1e3)
    name: str = setting("a", "name", choices=("a", "b"))


@dataclass(frozen=True)
class Whole:
    count: int = setting(1, "number [-]", low=0)
    on: bool = setting(False, "switch")
    part: Part = field(default_factory=Part)
    spare: Part | None = None
    shapes: tuple[Shape, ...] = ()
    text: str = ""


KINDS = {Shape: {"circle": Circle, "box": Box}}


def read(text):
    return fill(Whole, parse_yaml(text, "x.yaml"), KINDS)


def test_what_is_left_out_keeps_its_default():
    assert read("") == Whole()
    assert read("part:") == Whole()


def test_every_kind_of_value_is_read():
    whole = read(
        "count: 3\non: true\npart: {rate_hz: 4e2, name: b}\nspare: {}\n"
        "shapes: [{kind: circle, radius: 2}, {kind: box, sides: [3, 4]}]\ntext: 2020-01-01\n"
    )
    assert whole == Whole(
        3, True, Part(400.0, "b"), Part(), (Circle(2.0), Box((3.0, 4.0))), "2020-01-01"
    )


def test_false_takes_an_optional_part_away():
    assert read("spare: false").spare is None


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("on: true\ncuont: 3", 2, "cuont is not known"),
        ("part:\n  rate_hz: 0.5", 2, "outside"),
        ("part:\n  rate_hz: fast", 2, "no number"),
        ("part:\n  rate_hz: .nan", 2, "no number"),
        ("part:\n\n  name: c", 3, "not one of a, b"),
        ("count: 1.5", 1, "not a whole number"),
        ("count: true", 1, "no number"),
        ("on: 1", 1, "not true or false"),
        ("shapes:\n- kind: circle\n- radius: 1", 3, "has no kind"),
        ("shapes:\n- kind: star", 2, "'star' of shapes is not known"),
        ("shapes:\n- {kind: box, sides: [1, 2, 3]}", 2, "has 3, not 2"),
        ("shapes:\n- {kind: box, sides: [1, -2]}", 2, "outside"),
        ("shapes: 3", 1, "not a list"),
        ("shapes:\n- kind: [1]", 2, "of shapes is not known"),
        ("text: [a]", 1, "no text"),
        ("part: 3", 1, "not a mapping"),
        ("count: 1\ncount: 2", 2, "given twice"),
        ("count: [", 1, "is not YAML"),
        ("count: !!python/object:os.system x", 1, "is not YAML"),
        ("- 1", 1, "not a mapping"),
    ],
)
def test_a_fault_is_named_with_its_line(text, line, reason):
    with pytest.raises(InputError) as caught:
        read(text)
    assert str(caught.value).startswith(f"x.yaml:{line}: ")
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_overlay_merges_mappings_and_replaces_the_rest():
    base = parse_yaml("part: {rate_hz: 5, name: b}\nshapes: [{kind: circle}]", "a")
    more = parse_yaml("part: {rate_hz: 6}\nshapes: []", "b")
    assert fill(Whole, overlay(base, more), KINDS) == Whole(part=Part(6.0, "b"))


def test_an_override_reaches_into_lists_and_makes_what_is_not_there():
    base = parse_yaml("shapes: [{kind: circle}, {kind: circle}]", "a")
    changed = override(override(base, "shapes.1.radius=7"), "part.name=b")
    whole = fill(Whole, changed, KINDS)
    assert (whole.shapes, whole.part.name) == ((Circle(), Circle(7.0)), "b")


@pytest.mark.parametrize("text", ["a", "=1", "a..b=1", "shapes.2.radius=1", "a=[", "part.x=1"])
def test_a_bad_override_is_named(text):
    base = parse_yaml("shapes: [{kind: circle}]", "a")
    with pytest.raises(InputError, match="--set"):
        fill(Whole, override(base, text), KINDS)


def test_aliases_that_multiply_are_refused_soon():
    text = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    for k, name in enumerate("bcdefgh"):
        text += f"{name}: &{name} [{', '.join(['*' + 'abcdefg'[k]] * 10)}]\n"
    with pytest.raises(InputError, match="more than"):
        read(text)


@settings(max_examples=300, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_settings_or_one_line(text):
    reason = ""
    try:
        read(text)
    except InputError as error:
        reason = str(error)
    assert len(reason.splitlines()) <= 1
