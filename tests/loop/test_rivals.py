"""Names as a reader reads them, and what has none."""

from __future__ import annotations

import pytest

from imucalib.effects.shape import in_words


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("curve@bias:tool_face:0:5.235987756:6", "a curve of the bias against tool face"),
        ("shape@response:xyz:soft_saturation:0.3", "a soft saturation of the response"),
        ("follows@scale:supply_V:12:0.5", "scale follows supply_V"),
        ("converter@xyz", "converter, xyz"),
        ("squares_across", "squares across"),
        ("slip@record18:z", "slip, record 18, z"),
        ("thermal_lag@1.5h", "thermal lag, 1.5 h"),
        ("thermal_hysteresis@2C", "thermal hysteresis, 2 °C"),
    ],
)
def test_names_for_a_reader(name: str, words: str) -> None:
    assert in_words(name) == words
