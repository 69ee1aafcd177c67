"""A document held against its JSON Schema (draft 2020-12, the keywords that ours use)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

_KINDS: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list, tuple),
    "string": (str,),
    "number": (int, float),
    "integer": (int,),
    "boolean": (bool,),
    "null": (type(None),),
}


@cache
def schema_of(name: str) -> dict[str, Any]:
    """The schema of a kind of document: "calibration" or "report"."""
    text = (files("imucalib") / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def misfits(content: Any, schema: Mapping[str, Any]) -> Iterator[str]:
    """Where and how a document does not fit its schema, in words. A number that is not finite,
    which JSON has not, fits nowhere, nor one whose square, a variance, is not."""
    return _misfits(content, schema, schema.get("$defs", {}), "")


def _misfits(value: Any, schema: Any, defs: Mapping[str, Any], place: str) -> Iterator[str]:
    if "$ref" in schema:
        schema = defs[schema["$ref"].rpartition("/")[2]]
    if words := next(_plain_misfits(value, schema), ""):
        yield f"{place or 'it'} {words}"
        return
    forms = [[*_misfits(value, one, defs, place)] for one in schema.get("oneOf", ())]
    if forms and all(forms):
        yield from min(forms, key=len)  # of the form that it is nearest to
    elif len(forms) - sum(map(bool, forms)) > 1:
        yield f"{place or 'it'} fits more than one of {len(forms)} forms"
    for key, one, its in _inside(value, schema):
        below = f"{place}.{key}" if place else key
        if its is False:
            yield f"{below} is not known"
        else:
            yield from _misfits(one, its, defs, below)


def _inside(value: Any, schema: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Key or name, value and schema of everything in a block."""
    if isinstance(value, Mapping):
        known, other = schema.get("properties", {}), schema.get("additionalProperties", {})
        other = {} if other is True else other
        yield from ((str(key), one, known.get(key, other)) for key, one in value.items())
    elif isinstance(value, list | tuple):
        its = schema.get("items", {})
        for k, one in enumerate(value):
            name = one.get("name", k) if isinstance(one, Mapping) else k
            yield str(name), one, its


def _plain_misfits(value: Any, schema: Mapping[str, Any]) -> Iterator[str]:
    """The same of a value's type, size and choices."""
    kinds = schema.get("type", ())
    kinds = (kinds,) if isinstance(kinds, str) else kinds
    fits = any(isinstance(value, _KINDS[kind]) for kind in kinds)
    if kinds and (not fits or (isinstance(value, bool) and "boolean" not in kinds)):
        yield f"is no {' or '.join(kinds)}"
    elif isinstance(value, float) and value and not 0.0 < value * value < math.inf:
        yield "is no finite number, or its square is none"
    if "const" in schema and value != schema["const"]:
        yield f"is not {schema['const']}"
    if "enum" in schema and value not in schema["enum"]:
        yield f"is none of {', '.join(map(str, schema['enum']))}"
    if isinstance(value, dict) and (absent := set(schema.get("required", ())) - value.keys()):
        yield f"lacks {min(absent)}"
    if isinstance(value, list | tuple):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf):
            yield f"has {len(value)} entries"
    elif isinstance(value, int | float):
        low, high = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
        if not low <= value <= high or value <= schema.get("exclusiveMinimum", -math.inf):
            yield f"is {value:g}, beyond what it can be"
