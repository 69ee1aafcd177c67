"""One way to write and to load YAML: what is written comes back, what is broken is refused."""

from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.recording.yaml_text import dump, load


@pytest.mark.parametrize("text", ["[" * 5000, "a: 1\na: 2\n", "a: [1\n", "\x00", "\udcff"])
def test_what_is_not_yaml_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UnreadableInput, match="not a YAML file") as caught:
        load(path, "write another")
    assert caught.value.where == str(path)
    assert caught.value.remedy == "write another"


@pytest.mark.parametrize(
    "value", [np.inf, -np.inf, np.nan, 0.1, -1e22, 1e300, 5e-324, 1e-5, 2.5e-7, 0.0, 123456789.125]
)
def test_every_number_comes_back(value: float, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(dump({"value": value}), encoding="utf-8")
    found = load(path)["value"]
    assert isinstance(found, float)
    np.testing.assert_array_equal(found, value)


@pytest.mark.parametrize("text", ["a: &x [1]\nb: *x\n", "a: 1\nb: &x 2\n", "a: {<<: *y}\n"])
def test_anchors_and_aliases_are_refused_with_their_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableInput, match=r"anchor or alias '[xy]'[\s\S]*line [12]"):
        load(path)


def test_a_bomb_of_aliases_costs_nothing(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x,x,x,x,x,x,x,x,x]"]
    lines += [f"a{k}: &a{k} [{','.join(9 * [f'*a{k - 1}'])}]" for k in range(1, 12)]
    path = tmp_path / "c.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(UnreadableInput, match="line 1"):
        load(path)
