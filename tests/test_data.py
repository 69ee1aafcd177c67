"""Data as JSON obey the schema that is made of their types, and say no more than it."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import jsonschema
import numpy as np
import pytest

from imucalib.data import Data, documents, plain, schema_of


class Row(Data):
    """A row."""

    name: str
    sizes: Annotated[np.ndarray, "Of each axis, mg."]
    sd: float
    rest: Literal["still", "moved"] = "still"
    why: str | None = None


class Page(Data, name="page_of_a_test/3"):
    """A page."""

    rows: tuple[Row, ...]
    by_name: Mapping[str, Row]
    last: Row | None
    count: int


class Own(Data, beside=("page_of_a_test", "count", "1")):
    """What stands beside it."""

    extra: float


ROW = Row("a", np.array([1.0, np.nan, 3.0]), np.nan)
PAGE = Page(rows=(ROW,), by_name={"a": ROW}, last=None, count=1)


def validator() -> jsonschema.Draft202012Validator:
    schema = schema_of(documents()["page_of_a_test"][:1])
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_a_document_obeys_its_schema() -> None:
    content = plain(PAGE)
    assert content["schema"] == "imucal/page_of_a_test/3"
    assert content["last"] is None
    assert content["rows"] == [
        {"name": "a", "sizes": [1.0, None, 3.0], "sd": None, "rest": "still"}
    ]
    validator().validate(content)


@pytest.mark.parametrize(
    "change",
    [
        {"count": "one"},
        {"count": 1.5},
        {"more": 1},
        {"rows": [{"name": "a"}]},
        {"rows": [{**plain(ROW), "why": None}]},
        {"rows": [{**plain(ROW), "rest": "lost"}]},
        {"by_name": {"a": {**plain(ROW), "unit": "mg"}}},
        {"schema": "imucal/page_of_a_test/2"},
    ],
)
def test_what_a_type_does_not_allow_breaks_it(change: dict[str, Any]) -> None:
    assert list(validator().iter_errors(plain(PAGE) | change))


def test_meanings_are_in_the_schema() -> None:
    row = schema_of([Page])["properties"]["rows"]["items"]
    assert row["description"] == "A row."
    assert row["properties"]["sizes"]["description"] == "Of each axis, mg."
    assert row["required"] == ["name", "sizes", "sd", "rest"]


def test_keys_beside_a_document_hold_where_its_key_says_so() -> None:
    schema = schema_of(documents()["page_of_a_test"])
    (part,) = schema["allOf"]
    assert part["if"] == {"properties": {"count": {"const": "1"}}}
    assert part["then"]["anyOf"][0]["required"] == ["extra"]
    assert schema["additionalProperties"] is True


def test_attributes_are_read_by_their_names() -> None:
    source = SimpleNamespace(name="b", noise=SimpleNamespace(sd=2.0), why=None, rest="moved")
    made = Row.of(source, "sd=noise.sd", sizes=np.zeros(3))
    assert (made.name, made.sd, made.rest, made.why) == ("b", 2.0, "moved", None)
    with pytest.raises(AttributeError):
        Row.of(SimpleNamespace(), sizes=np.zeros(3))
