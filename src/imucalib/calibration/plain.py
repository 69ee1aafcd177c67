"""Results as plain types, as YAML and JSON take them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from operator import attrgetter
from typing import Any

from imucalib.data import plain

#: What has an end of its own in JSON.
_MANY = (dict, list, tuple)


def fields(source: object, names: str) -> dict[str, Any]:
    """Some attributes of an object as plain types, in their order.

    names : separated by blanks; "rate_hz=clock.rate" is an attribute's attribute by a name of its
    own
    """
    parts = (name.rpartition("=") for name in names.split())
    return {key or path: plain(attrgetter(path)(source)) for key, _, path in parts}


def list_fields(sources: Iterable[object], names: str) -> list[dict[str, Any]]:
    """`fields` of each of some objects."""
    return [fields(source, names) for source in sources]


def json_text(content: Any, indent: str = "") -> str:
    """JSON of plain types; a list of numbers or words is on one line. Raises ValueError for NaN."""
    inner, ends, lines = indent + "  ", "[]", list[str]()
    if isinstance(content, dict) and content:
        ends = "{}"
        lines = [
            f"{json.dumps(k, ensure_ascii=False)}: {json_text(v, inner)}"
            for k, v in content.items()
        ]
    elif isinstance(content, list | tuple) and any(isinstance(v, _MANY) for v in content):
        lines = [json_text(v, inner) for v in content]
    if not lines:
        return json.dumps(content, ensure_ascii=False, allow_nan=False)
    return f"{ends[0]}\n{inner}" + f",\n{inner}".join(lines) + f"\n{indent}{ends[1]}"
