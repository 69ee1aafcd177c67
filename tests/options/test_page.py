"""docs/testing.md lists the options as they are."""

from __future__ import annotations

from options.listed import table
from testing_page import PAGE, filled


def test_the_list_is_that_of_the_cases() -> None:
    assert PAGE.read_text(encoding="utf-8") == filled("options", table()), "python tests/options"
