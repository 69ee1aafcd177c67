"""Sensors are paired by name, whatever their order; in order only where no name fits."""

from __future__ import annotations

import string
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib.errors import UnreadableInput
from imucalib.recording.pairing import channel_names, distinct_names, paired
from imucalib.recording.recording import Channel, Recording

WORDS = st.text(string.ascii_lowercase + "_", min_size=1, max_size=6)


def recording(
    triads: Sequence[str], names: Sequence[tuple[str, ...]] = (), *, numbered: bool = False
) -> Recording:
    t = np.arange(3.0)
    channels = {
        f"{name}/acceleration": Channel(
            t,
            np.zeros((3, 3)),
            "m/s2",
            "acceleration",
            name,
            1.0,
            names=names[k] if names else (),
            numbered=numbered,
        )
        for k, name in enumerate(triads)
    }
    return Recording(channels, "a.mcap", "mcap", "")


@given(st.lists(WORDS, min_size=2, max_size=6, unique=True), st.randoms())
def test_the_order_of_either_side_is_nothing(names: list[str], random: object) -> None:
    other = list(names)
    random.shuffle(other)  # type: ignore[attr-defined]
    found = paired([(n,) for n in names], recording(other), "the board")
    assert {r: names[k] for r, k in found.partner.items()} == {n: n for n in names}
    assert not found.notes


@given(st.lists(WORDS, min_size=2, max_size=6, unique=True), st.randoms())
def test_a_part_of_the_topic_is_a_name(names: list[str], random: object) -> None:
    other = list(names)
    random.shuffle(other)  # type: ignore[attr-defined]
    topics = [(f"/Robot/{n}/Data",) for n in other]
    plain = recording([f"imu{k}" for k in range(len(names))], topics, numbered=True)
    found = paired([(n,) for n in names], plain, "the board")
    assert [names[found.partner[f"imu{k}"]] for k in range(len(names))] == other
    assert distinct_names(topics) == tuple(other)


@given(st.lists(WORDS, min_size=3, max_size=6, unique=True), st.integers(1, 2))
def test_names_left_over_on_both_sides_are_told(names: list[str], wrong: int) -> None:
    other = [*names[:-wrong], *(f"{n}X" for n in names[-wrong:])]
    with pytest.raises(UnreadableInput) as error:
        paired([(n,) for n in names], recording(other), "the board")
    for name in (*names[-wrong:], *other[-wrong:]):
        assert name in error.value.what


def test_the_channel_that_was_calibrated_counts_where_names_do_not() -> None:
    was = recording(["imu0", "imu1"], [("/a[0]",), ("/a[1]",)], numbered=True)
    kept = channel_names(was)
    assert kept == {"imu0": "/a[0]", "imu1": "/a[1]"}
    turned = recording(["imu0", "imu1"], [("/a[1]",), ("/a[0]",)], numbered=True)
    wanted = [("left", kept["imu0"]), ("right", kept["imu1"])]
    assert paired(wanted, turned, "the calibration").partner == {"imu0": 1, "imu1": 0}
