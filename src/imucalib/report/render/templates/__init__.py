"""The templates of a page, a figure and the catalogue, and how they are filled in."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

# What XML 1.0 does not allow at all, not even escaped, and the controls that HTML rejects.
_FORBIDDEN = re.compile(
    "[^\t\n\x20-\x7e\xa0-\ud7ff\ue000-\ufdcf\ufdf0-\ufffd\U00010000-\U0010ffff]"
)


def fill(name: str, **values: Any) -> Markup:
    """A template with its values: of a page all escaped; what XML forbids becomes U+FFFD.

    name : file of this folder; a value that is markup already stays as it is
    """
    from markupsafe import Markup

    return Markup(_templates().get_template(name).render(**values))


def short(value: float) -> str:
    """A coordinate to a tenth of a unit without trailing zeros."""
    return f"{value:.1f}".removesuffix(".0")


@cache
def _templates() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    made = Environment(
        loader=FunctionLoader(lambda name: (files(__name__) / name).read_text(encoding="utf-8")),
        autoescape=lambda name: not str(name).endswith(".md.j2"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda v: v if isinstance(v, Markup) else _FORBIDDEN.sub("\ufffd", str(v)),
    )
    made.filters |= {"short": short, "kind": lambda block: type(block).__name__}
    return made
