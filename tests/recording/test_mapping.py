"""Field mappings: saved and loaded without loss, wrong ones refused with the field's name."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.mapping import (
    FieldMapping,
    from_dict,
    load_mapping,
    save_mapping,
)

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
        ({"skip": "x"}, "not a valid skip"),
        ({"skip": -1}, "negative"),
        ({"header": "yes"}, "not a valid header"),
        ({"axis_map": "x,y"}, "x, y and z once each"),
        ({"axis_map": "x,x,z"}, "x, y and z once each"),
        ({"time_unit": "days"}, "unknown time unit"),
        ({"decimal": ";"}, "neither"),
        ({"lsb_per_g": [0]}, "not zero"),
        ({"lsb_per_dps": [1.0, float("inf")]}, "finite"),
        ({"rate": 0}, "not a positive number"),
        ({"axis_map": "x,y,--z"}, "x, y and z once each"),
        ({"axis_map": "x,y,z,x"}, "x, y and z once each"),
    ],
)
def test_bad_fields_are_named(data: dict[str, object], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        from_dict(data)


@pytest.mark.parametrize("text", ["- a\n- b\n", "", "a: b: c", "acc: [x\n", "\x00"])
def test_bad_yaml_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(UnreadableInput, match=r"m\.yaml"):
        load_mapping(path)
