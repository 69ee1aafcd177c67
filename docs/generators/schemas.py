"""JSON Schemas of what commands print and write, from the types of the data; and their page."""

from __future__ import annotations

import importlib
import json
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import imucalib
from generators.markdown import cell
from imucalib.data import documents, schema_of

_HEAD = """# Schemas

What commands print with `--json`, `report.json` and `calibration.yaml` obey these JSON Schemas (draft 2020-12), which are
part of the package (`imucalib/schemas`); the tests hold every document against them. Generated from the schemas: a line an
object that needs words, keys that may be left out in brackets.
"""
FOLDER = Path(imucalib.__file__).parent / "schemas"


def files() -> dict[str, str]:
    """File -> schema of every document that is a type."""
    for module in pkgutil.walk_packages(imucalib.__path__, "imucalib."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    return {
        f"{name}.schema.json": json.dumps(schema_of(forms), indent=1, ensure_ascii=False)
        for name, forms in documents().items()
    }


def page() -> str:
    """The page."""
    lines, made = [_HEAD], files()
    names = [
        "report.schema.json",
        *sorted({path.name for path in FOLDER.glob("*.json")} | set(made)),
    ]
    for file in dict.fromkeys(names):
        schema = json.loads(made.get(file) or (FOLDER / file).read_text(encoding="utf-8"))
        lines += [f"## {schema['$id']}", "", f"[{file}](../../src/imucalib/schemas/{file})"]
        for form in schema.get("oneOf", [schema]):
            lines += ["", form.get("description", ""), "", *_objects(form, "")]
        lines += [
            line for name, one in schema.get("$defs", {}).items() for line in _objects(one, name)
        ]
        for part in schema.get("allOf", ()):
            ((key, value),) = part["if"]["properties"].items()
            for one in part["then"]["anyOf"]:
                lines += ["", f"Where `{key}` is `{value['const']}`: {one['description']}", ""]
                lines += [line for line in _objects(one, "") if line not in lines]
        lines.append("")
    return "\n".join(lines)


def _objects(schema: dict[str, Any], path: str) -> Iterator[str]:
    """A line an object: its keys, those in brackets that may be left out, and what they mean."""
    keys, required = schema.get("properties", {}), schema.get("required", ())
    if any(not path or {"description", "enum"} & one.keys() for one in keys.values()):
        told = (
            _told(name, one, name in required) for name, one in keys.items() if name != "schema"
        )
        yield f"- {f'`{path}`: ' if path else ''}{', '.join(told)}"
    for name, one in keys.items():
        below = f"{path}.{name}" if path else name
        yield from _objects(one, below)
        for step, inside in (("[]", "items"), (".*", "additionalProperties")):
            if isinstance(one.get(inside), dict):
                yield from _objects(one[inside], f"{below}{step}")


def _told(name: str, one: dict[str, Any], required: bool) -> str:
    means = cell(one.get("description", "").rstrip("."))
    words = " or ".join(f"`{word}`" for word in one.get("enum", ()))
    aside = "; ".join(filter(None, (f"{means[:1].lower()}{means[1:]}", words)))
    key = f"`{name}`" if required else f"[`{name}`]"
    return f"{key} ({aside})" if aside else key
