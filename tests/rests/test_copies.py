"""Channels of one chip are told from two chips that lie side by side."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import still_segments
from imucalib.writers import write
from worlds.command import run

G, HZ, NOISE = 9.80665, 100.0, 0.03


def truth(rng: np.random.Generator, rests: int = 8) -> Array:
    """Rests of two seconds and turns of a half between them, m/s²."""
    ends = rng.normal(size=(rests, 3))
    ends *= G / np.linalg.norm(ends, axis=1, keepdims=True)
    parts = [np.tile(ends[0], (200, 1))]
    for a, b in pairwise(ends):
        way = np.linspace(a, b, 50) + rng.normal(0.0, 0.5, (50, 3))
        parts += [way, np.tile(b, (200, 1))]
    return np.concatenate(parts)


def filtered(values: Array, share: float) -> Array:
    """A low-pass of the first order."""
    out = values.copy()
    for n in range(1, len(out)):
        out[n] = out[n - 1] + share * (values[n] - out[n - 1])
    return out


def recorded(seed: int = 1) -> Recording:
    rng = np.random.default_rng(seed)
    force = truth(rng)
    noise = rng.normal(0.0, NOISE, (2, *force.shape))
    raw, other = force + noise[0], 1.002 * force + noise[1]
    same = force + rng.normal(0.0, NOISE, force.shape)
    found = {
        "smooth": filtered(raw, 0.3),
        "raw": raw,
        "offset": raw + np.array([0.1, -0.2, 0.05]),
        "other": other,
        "alike": same,
    }
    t = np.arange(len(force)) / HZ
    channels = {
        f"{name}/acceleration": Channel(t, values, "m/s2", "acceleration", name, HZ)
        for name, values in found.items()
    }
    return Recording(channels, "made", "made", "")


@pytest.mark.parametrize("seed", range(5))
def test_copies_are_one_chip_and_a_chip_without_errors_is_another(seed: int) -> None:
    """Whichever of two equal ones is the copy; never the filtered one the raw one."""
    segments = still_segments(recorded(seed))
    copies = segments.copies()
    assert set(copies) in ({"smooth", "offset"}, {"smooth", "raw"})
    assert set(copies.values()) <= {"raw", "offset"}
    for copy, raw in copies.items():
        assert any(note.startswith(f"{copy} repeats {raw}") for note in segments.notes)


def test_of_one_chip_the_raw_readings_are_proposed_and_no_board(tmp_path: Path) -> None:
    whole = recorded()
    for names, board in ((("smooth", "raw"), False), (("smooth", "raw", "other"), True)):
        some = {f"{n}/acceleration": whole.channels[f"{n}/acceleration"] for n in names}
        path = tmp_path / "log.mcap"
        write(Recording(some, "made", "made", ""), path)
        page = " ".join(run("inspect", path).stdout.replace("\\\n", " ").split())
        assert "smooth repeats raw" in page
        assert "--sensor smooth" not in page
        assert ("imucal array" in page) == board
