"""One way to write and to load YAML: what is written comes back, what is broken is refused."""

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from imucalib.errors import UnreadableInput
from imucalib.recording.yaml_text import dump, load


def test_words_that_older_readers_take_for_booleans_are_quoted(tmp_path: Path) -> None:
    content = {"names": ["NO", "on", "plain", "y"], "value": 1e-3, "flag": True, "text": "Off"}
    text = dump(content)
    assert '["NO", "on", plain, "y"]' in text
    assert 'text: "Off"' in text
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    assert load(path) == content


@pytest.mark.parametrize("text", ["[" * 5000, "a: 1\na: 2\n", "a: [1\n", "\x00", "\udcff"])
def test_what_is_not_yaml_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UnreadableInput, match="not a YAML file") as caught:
        load(path, "write another")
    assert caught.value.where == str(path)
    assert caught.value.remedy == "write another"


def test_an_absent_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableInput, match="cannot be read: No such file"):
        load(tmp_path / "gone.yaml")


@pytest.mark.parametrize("form", ["{}", "a{}b", "a{}", "{}b", "a {} b", "a\n{} \nb"])
@pytest.mark.parametrize("version", [(1, 2), (1, 1)])
def test_every_sign_comes_back(version: tuple[int, int], form: str) -> None:
    words = [form.format(chr(c)) for c in (*range(0x180), 0x2028, 0x2029, 0xFEFF, 0x1F600)]
    content = {"alone": dict(enumerate(words)), "among": [[word, 1.0] for word in words]}
    yaml = YAML(typ="safe", pure=True)
    yaml.version = version
    assert yaml.load(StringIO(dump(content))) == content


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
