"""The schema of whatever is printed as JSON: every run of the option tests is held against it."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema

import imucalib

FOLDER = Path(imucalib.__file__).parent / "schemas"


@cache
def _validator(name: str) -> jsonschema.Draft202012Validator:
    file = FOLDER / f"{name}.schema.json"
    assert file.is_file(), f"no schema of {name}: a type of its data and `make docs` make it"
    schema = json.loads(file.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def keep_schema(content: Any) -> None:
    """Assert that a document, or each of a list, names its schema and obeys it."""
    if isinstance(content, list):
        for one in content:
            keep_schema(one)
        return
    assert "schema" in content, f"a document without its schema: {sorted(content)}"
    name = content["schema"].split("/")[1]
    found = sorted(_validator(name).iter_errors(content), key=str)
    words = [f"{e.json_path}: {_deepest(e).message[:300]}" for e in found]
    assert not found, words[:5]
    if name == "logs":
        keep_schema([*content["logs"], *filter(None, [content.get("together")])])


def _deepest(error: jsonschema.ValidationError) -> jsonschema.ValidationError:
    """Of a document of several forms what fails in the form that it is nearest to."""
    return jsonschema.exceptions.best_match([error]) or error
