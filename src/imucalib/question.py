"""What only the user can decide, and the words of the command that decide it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass


def paste(*words: object) -> str:
    """Words of a command line as they are pasted into a shell: what is printed to be typed is made
    here, and nowhere else."""
    return shlex.join(map(str, words))


@dataclass(frozen=True)
class Question:
    """what : what was found, a sentence without its full stop
    options : words that the same command takes if that is right, none where no option settles it
    otherwise : what to type or do if it is not, in words
    """

    what: str
    options: tuple[str, ...] = ()
    otherwise: str = ""

    def __str__(self) -> str:
        if not self.options:
            return "; ".join(filter(None, (self.what, self.otherwise)))
        other = f" (or: {self.otherwise})" if self.otherwise else ""
        return f"{self.what}; decide with {paste(*self.options)}{other}"
