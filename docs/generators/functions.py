"""The Python API: what `imucalib` offers, from its own signatures and docstrings."""

from __future__ import annotations

import dataclasses
import inspect
from types import FunctionType
from typing import Any

import imucalib
from generators.markdown import block, table
from imucalib import errors
from imucalib.api.calibrators import Bench, Reading, Usual
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.lab.request import LabRequest

_HEAD = """# Every function and class

Generated from signatures and docstrings; [the Python API](../python.md) shows how they are used. Values are in SI
units unless a name says otherwise.
"""
_FUNCTIONS = ("lab", "actigraph", "array", "load", "read")
_CLASSES = ("Result", "Calibration", "Recording", "FieldMapping")


def page() -> str:
    """The page."""
    lines = [_HEAD, "## Functions", ""]
    for name in _FUNCTIONS:
        lines += _function(f"imucalib.{name}", getattr(imucalib, name), 3)
    lines += ["## Keywords", ""]
    for kind, known in ((Bench, Usual), (Usual, Reading), (Reading, dict)):
        lines += _keywords(kind, getattr(known, "__annotations__", ()))
    lines += ["## Classes", ""]
    for name in _CLASSES:
        lines += _class(f"imucalib.{name}", getattr(imucalib, name))
    lines += [
        "## Requests",
        "",
        "What a calibrator can be asked for beyond the keywords: `request=`.",
        "",
    ]
    for kind in (LabRequest, ActigraphRequest, ArrayRequest):
        lines += _class(f"{kind.__module__}.{kind.__name__}", kind)
    lines += [
        "## Exceptions",
        "",
        "Of `imucalib.errors`; `what`, `where`, `remedy`, `exit_code`.",
        "",
    ]
    kinds = [k for k in vars(errors).values() if isinstance(k, type)]
    rows = [(f"`{k.__name__}`", str(k.exit_code), inspect.getdoc(k) or "") for k in kinds]
    return "\n".join([*lines, *table(("exception", "exit code", "means"), rows)])


def _function(name: str, made: FunctionType, level: int) -> list[str]:
    signature = inspect.signature(made)
    shown = [_parameter(p) for p in signature.parameters.values() if p.name not in ("self", "cls")]
    star = next((i for i, p in enumerate(signature.parameters.values())
                 if p.kind is p.KEYWORD_ONLY), None)  # fmt: skip
    if star is not None:
        shown.insert(star, "*")
    call = f"{name}({', '.join(shown)}) -> {signature.return_annotation}"
    if len(call) > 100:
        call = f"{name}(\n    " + ",\n    ".join(shown) + f",\n) -> {signature.return_annotation}"
    return [f"{'#' * level} {name.rpartition('.')[2]}", "", "```python", call, "```", "",
            *_doc(made)]  # fmt: skip


def _parameter(one: inspect.Parameter) -> str:
    text = f"{one.name}: {one.annotation}"
    if one.default is one.empty:
        return text
    return f"{text} = {getattr(one.default, '__name__', repr(one.default))}"


def _class(name: str, kind: type) -> list[str]:
    lines = [f"### {name.rpartition('.')[2]}", "", "```python", name, "```", "", *_doc(kind)]
    if dataclasses.is_dataclass(kind):
        rows = [(f"`{f.name}`", f"`{f.type}`", _default(f)) for f in dataclasses.fields(kind)]
        lines += table(("field", "type", "default"), rows)
    for key, member in vars(kind).items():
        if key.startswith("_") or not inspect.getdoc(member):
            continue
        if isinstance(member, property):
            lines += [f"#### {key}", "", *_doc(member)]
        elif isinstance(member, FunctionType):
            lines += _function(f"{kind.__name__}.{key}", member, 4)
    return lines


def _keywords(kind: Any, known: Any) -> list[str]:
    """Those of a kind of options that another kind does not have already."""
    own = kind.__annotations__.items()
    rows = [(f"`{n}`", f"`{a.__forward_arg__}`") for n, a in own if n not in known]
    return [f"### {kind.__name__}", "", *_doc(kind), *table(("keyword", "type"), rows)]


def _default(one: dataclasses.Field[Any]) -> str:
    if one.default is not dataclasses.MISSING:
        return f"`{one.default!r}`"
    return "its own" if one.default_factory is not dataclasses.MISSING else "required"


def _doc(thing: object) -> list[str]:
    return block(inspect.getdoc(thing) or "")
