"""The sample logs: each has its source and licence beside it, and is what it says."""

from __future__ import annotations

import re

import numpy as np

from imucalib.readers import read
from worlds.places import SAMPLES


def test_every_sample_states_its_source() -> None:
    page = (SAMPLES / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w.]+)`", page))
    for path in SAMPLES.iterdir():
        if path.is_file() and path.name not in ("README.md", "demo.py"):
            short = path.stem.removeprefix("cave_")
            assert path.name in named or short in named, path.name
    for licence in re.findall(r"\((licences/\w+\.txt)\)", page):
        assert "Permission is hereby granted" in (SAMPLES / licence).read_text(encoding="utf-8")


def test_the_boards_part_is_of_its_log_and_leaves_its_first_rests_alone() -> None:
    whole, part = read(SAMPLES / "board.h5"), read(SAMPLES / "board_part.mcap")
    for name in ("imu0/acceleration", "imu7/angular_rate"):
        a, b = whole.channels[name], part.channels[name]
        start = int(np.searchsorted(a.t, 194.7))
        rest = slice(start, start + 300)
        np.testing.assert_allclose(a.values[rest], b.values[:300], rtol=1e-12)
        np.testing.assert_allclose(a.t[rest] - a.t[start], b.t[:300] - b.t[0], atol=1e-8)
