"""Errors that say what happened, where, and what to do; each kind owns one exit code.

This is the only place where a failure gets its exit code, so a script can rely on the number.
"""

from __future__ import annotations

from typing import ClassVar

#: Exit code of a calibration that is finished but whose residual stays unexplained.
UNEXPLAINED_EXIT_CODE = 5
#: Exit code of a fault of the program itself (EX_SOFTWARE of sysexits.h).
CRASH_EXIT_CODE = 70


class ImucalError(Exception):
    """A failure that the user can act on.

    `what` states the problem, `where` the file, row, byte or option, `remedy` the next step; `add`
    are words that the same command lacks: with them it runs.
    """

    exit_code: ClassVar[int] = 1

    def __init__(
        self, what: str, *, where: str = "", remedy: str = "", add: tuple[str, ...] = ()
    ) -> None:
        self.what, self.where, self.remedy, self.add = what, where, remedy, add
        super().__init__(str(self))

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}" if self.where else self.what
        if self.remedy and not text.endswith("\n"):
            text += ". "
        return text + self.remedy


class LimitBroken(ImucalError):
    """The calibration is valid but breaks a limit that the user gave."""

    exit_code = 1


class UsageError(ImucalError):
    """The call itself is wrong: an unknown name, a contradictory or missing option."""

    exit_code = 2


class UnreadableInput(ImucalError):
    """The input cannot be read, or what it holds is not what it must hold."""

    exit_code = 3


class UnnamedColumns(UnreadableInput):
    """A table whose headings do not say which columns are meant; it may be of another kind."""


class Undetermined(ImucalError):
    """The data cannot determine the parameters that were asked for."""

    exit_code = 4


class NotConverged(ImucalError):
    """An iteration ended before its result can be trusted."""

    exit_code = 6


#: Exit code -> what it says, as the overview and the pages have it.
EXIT_CODES = {
    0: "calibrated",
    LimitBroken.exit_code: "a limit of yours is broken",
    UsageError.exit_code: "usage",
    UnreadableInput.exit_code: "unreadable",
    Undetermined.exit_code: "not determined by the data",
    UNEXPLAINED_EXIT_CODE: "an open question changes the numbers, or what --fail-on names is there",
    NotConverged.exit_code: "not converged",
    CRASH_EXIT_CODE: "a fault of imucal",
}
