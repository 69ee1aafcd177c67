"""What report.json and calibration.yaml hold, from their JSON Schemas."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

from generators.markdown import table

_HEAD = """# Schemas

`report.json` and `calibration.yaml` obey these JSON Schemas (draft 2020-12), which are part of the package
(`imucalib/schemas`); the tests hold the files of every calibrator against them. Generated from the schemas.
"""
NAMES = ("report", "calibration")


def page() -> str:
    """The page."""
    lines = [_HEAD]
    for name in NAMES:
        file = f"{name}.schema.json"
        schema = json.loads((files("imucalib") / "schemas" / file).read_text(encoding="utf-8"))
        lines += [f"## {schema['title']}", "", schema.get("description", ""), "",
                  f"[{file}](../../src/imucalib/schemas/{file}), `{schema['$id']}`", "",
                  *table(("key", "type", "there", "meaning"), _rows(schema, ""))]  # fmt: skip
    return "\n".join(lines)


def _rows(schema: dict[str, Any], path: str) -> Iterator[tuple[str, str, str, str]]:
    required = schema.get("required", ())
    for name, one in schema.get("properties", {}).items():
        key = f"{path}{name}"
        yield (
            f"`{key}`",
            _type(one),
            "always" if name in required else "",
            one.get("description", ""),
        )
        yield from _rows(one, f"{key}.")
        if isinstance(one.get("items"), dict):
            yield from _rows(one["items"], f"{key}[].")
        if isinstance(one.get("additionalProperties"), dict):
            yield from _rows(one["additionalProperties"], f"{key}.*.")


def _type(one: dict[str, Any]) -> str:
    if "const" in one:
        return f"`{one['const']}`"
    if "enum" in one:
        return ", ".join(f"`{v}`" for v in one["enum"])
    if "$ref" in one:
        return f"`{one['$ref'].rpartition('/')[2]}`"
    for many in ("anyOf", "oneOf"):
        if many in one:
            return " or ".join(_type(o) for o in one[many])
    kind = one.get("type", "any")
    return " or ".join(kind) if isinstance(kind, list) else str(kind)
