"""Print the release series of every lower bound of pyproject.toml, as pip's constraints.

"numpy>=2.0" becomes "numpy==2.0.*": the last repair of the oldest series that is promised.
"""

from __future__ import annotations

import re
import tomllib
from itertools import chain
from pathlib import Path

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"


def constraints() -> list[str]:
    """One line a dependency, extras included. Raises ValueError for one without a lower bound."""
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    stated = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    lowest: dict[str, str] = {}
    for text in stated:
        found = re.fullmatch(r"([\w.-]+)>=([\d.]+)(?:; python_version .*)?", text)
        if not found:
            raise ValueError(f"{text}: no lower bound alone")
        # The tests may need more than an extra promises.
        lowest[found[1]] = max(lowest.get(found[1], "0"), found[2], key=_parts)
    return [f"{name}=={version}.*" for name, version in sorted(lowest.items())]


def _parts(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("."))


if __name__ == "__main__":
    print("\n".join(constraints()))
