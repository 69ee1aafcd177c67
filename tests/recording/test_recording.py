"""Mappings, names that pair, and YAML that may not surprise."""

from __future__ import annotations

import string
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from imucalib.calibration.file import read as read_calibration
from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.mapping import FieldMapping, from_dict, load_mapping, save_mapping
from imucalib.recording.pairing import channel_names, distinct_names, pair
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.yaml_text import dump, load

NAMES = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cs", "Cc"), exclude_characters=","),
    min_size=1,
).map(str.strip).filter(bool)  # fmt: skip
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
MAPPINGS = st.builds(
    FieldMapping,
    acc=st.lists(NAMES, max_size=4).map(tuple),
    gyro=st.lists(NAMES, max_size=4).map(tuple),
    time=st.one_of(st.just(""), NAMES),
    acc_unit=st.sampled_from(["", "g", "counts", "NO", "1e-3"]),
    lsb_per_g=st.lists(NUMBERS.filter(lambda v: v != 0), max_size=3).map(tuple),
    acc_offset=st.lists(NUMBERS, max_size=3).map(tuple),
    rate=st.one_of(st.none(), st.floats(1e-6, 1e6)),
    axis_map=st.sampled_from(["", "x,-y,z", "z,x,y"]),
    skip=st.one_of(st.none(), st.integers(0, 1000)),
    header=st.sampled_from([None, True, False]),
    decimal=st.sampled_from(["", ".", ","]),
    delimiter=st.sampled_from(["", ",", ";", "\t", " ", "|"]),
)


@pytest.mark.slow
@given(mapping=MAPPINGS)
@example(mapping=FieldMapping(gyro=("?0",)))
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_saved_and_loaded(mapping: FieldMapping, tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    save_mapping(mapping, path)
    assert load_mapping(path) == mapping
    assert from_dict(mapping.to_dict()) == mapping
    assert [p.name for p in tmp_path.iterdir()] == ["m.yaml"]


@pytest.mark.parametrize(
    ("data", "match"),
    [
        ({"acc_units": "g"}, "unknown field 'acc_units'"),
        ({"rate": "fast"}, "'fast' is not a valid rate"),
        ({"rate": -1}, "not a positive number"),
        ({"rate": float("nan")}, "not a positive number"),
        ({"skip": -1}, "negative"),
        ({"header": "yes"}, "not a valid header"),
        ({"axis_map": "x,x,z"}, "x, y and z once each"),
        ({"axis_map": "x,y,--z"}, "x, y and z once each"),
        ({"time_unit": "days"}, "unknown time unit"),
        ({"decimal": ";"}, "neither"),
        ({"lsb_per_g": [0]}, "not zero"),
        ({"lsb_per_dps": [1.0, float("inf")]}, "finite"),
    ],
)
def test_bad_fields_are_named(data: dict[str, object], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        from_dict(data)


@pytest.mark.parametrize("text", ["- a\n- b\n", "", "a: b: c"])
def test_what_is_no_mapping_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(UnreadableInput, match=r"m\.yaml"):
        load_mapping(path)


WORDS = st.text(string.ascii_lowercase + "_", min_size=1, max_size=6)


def recording(
    triads: Sequence[str], names: Sequence[tuple[str, ...]] = (), *, numbered: bool = False
) -> Recording:
    channels = {}
    for k, name in enumerate(triads):
        own = names[k] if names else ()
        zero = Channel(np.arange(3.0), np.zeros((3, 3)), "m/s2", "acceleration", name, 1.0)
        channels[f"{name}/acceleration"] = replace(zero, names=own, numbered=numbered)
    return Recording(channels, "a.mcap", "mcap", "")


@given(st.lists(WORDS, min_size=2, max_size=6, unique=True), st.randoms())
def test_the_order_of_either_side_is_nothing(names: list[str], random: object) -> None:
    other = list(names)
    random.shuffle(other)  # type: ignore[attr-defined]
    found = pair([(n,) for n in names], recording(other), "the board")
    assert {r: names[k] for r, k in found.partner.items()} == {n: n for n in names}
    assert not found.notes


@given(st.lists(WORDS, min_size=2, max_size=6, unique=True), st.randoms())
def test_a_part_of_the_topic_is_a_name(names: list[str], random: object) -> None:
    other = list(names)
    random.shuffle(other)  # type: ignore[attr-defined]
    topics = [(f"/Robot/{n}/Data",) for n in other]
    plain = recording([f"imu{k}" for k in range(len(names))], topics, numbered=True)
    found = pair([(n,) for n in names], plain, "the board")
    assert [names[found.partner[f"imu{k}"]] for k in range(len(names))] == other
    assert distinct_names(topics) == tuple(other)


@given(st.lists(WORDS, min_size=3, max_size=6, unique=True), st.integers(1, 2))
def test_names_left_over_on_both_sides_are_told(names: list[str], wrong: int) -> None:
    other = [*names[:-wrong], *(f"{n}X" for n in names[-wrong:])]
    with pytest.raises(UnreadableInput) as error:
        pair([(n,) for n in names], recording(other), "the board")
    for name in (*names[-wrong:], *other[-wrong:]):
        assert name in error.value.what


def test_the_channel_that_was_calibrated_counts_where_names_do_not() -> None:
    was = recording(["imu0", "imu1"], [("/a[0]",), ("/a[1]",)], numbered=True)
    kept = channel_names(was)
    assert kept == {"imu0": "/a[0]", "imu1": "/a[1]"}
    turned = recording(["imu0", "imu1"], [("/a[1]",), ("/a[0]",)], numbered=True)
    wanted = [("left", kept["imu0"]), ("right", kept["imu1"])]
    assert pair(wanted, turned, "the calibration").partner == {"imu0": 1, "imu1": 0}


@pytest.mark.parametrize("text", ["[" * 5000, "a: 1\na: 2\n", "a: [1\n", "\x00", "\udcff"])
def test_what_is_not_yaml_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UnreadableInput, match="not a YAML file") as caught:
        load(path, "write another")
    assert caught.value.where == str(path)
    assert caught.value.remedy == "write another"


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 36)


LARGE = {
    "sparse": sparse,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "keys": lambda path: path.write_text("".join(f"k{k}: v\n" for k in range(200_000))),
    "lists": lambda path: path.write_text("a:\n" + "- [1.5, 2.5]\n" * 100_000),
}


@pytest.mark.parametrize("kind", LARGE)
def test_what_is_too_large_is_refused_before_it_is_parsed(kind: str, tmp_path: Path) -> None:
    path, begin = tmp_path / "c.yaml", time.process_time()
    LARGE[kind](path)
    for reading in (load, read_calibration):
        with pytest.raises(UnreadableInput) as caught:
            reading(path)
        assert caught.value.where == str(path)
    assert time.process_time() - begin < 2.0


@pytest.mark.parametrize(
    "value", [np.inf, -np.inf, np.nan, 0.1, -1e22, 1e300, 5e-324, 1e-5, 2.5e-7, 0.0, 123456789.125]
)
def test_every_number_comes_back(value: float, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(dump({"value": value}), encoding="utf-8")
    found = load(path)["value"]
    assert isinstance(found, float)
    np.testing.assert_array_equal(found, value)


NINES = "a0: &a0 [x]\n" + "".join(f"a{k}: &a{k} [{'*a0,' * 9}]\n" for k in range(1, 12))


@pytest.mark.parametrize("text", ["a: &x [1]\nb: *x\n", "a: 1\nb: &x 2\n", "a: {<<: *y}\n", NINES])
def test_anchors_and_aliases_are_refused_with_their_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableInput, match=r"anchor or alias '[axy]0?'[\s\S]*line [12]"):
        load(path)


_NUMBERS = st.lists(st.integers(-(10**6), 10**6) | NUMBERS, max_size=90)
_TEXTS = st.sampled_from(["[1, 2]", "a [1.0, 2.0] b", "[1, 2] and [3, 4]", "x [", "[1,2]"])
_CONTENT = st.recursive(
    _NUMBERS | _TEXTS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_TEXTS, inner)
)


@settings(max_examples=40, deadline=None)
@given(content=st.dictionaries(st.text("abc", min_size=1), _CONTENT))
def test_lists_of_numbers_are_read_as_any_yaml(content: dict[str, object]) -> None:
    """What is loaded fast is what the package loads, texts with such a list in them too."""
    text = dump(content)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.yaml"
        path.write_text(text, encoding="utf-8")
        assert load(path) == YAML(typ="safe", pure=True).load(text) == content
