"""Signs of life: after a second, on stderr, never with --quiet; --verbose says when and what."""

from __future__ import annotations

import re
import time

import pytest

from imucalib.cli import output as module
from imucalib.cli.output import working


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_FIRST", 0.01)
    monkeypatch.setattr(module, "_NEXT", 0.01)


def test_work_that_takes_long_shows_that_it_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    with working("searching", quiet=False) as say:
        say("read a file")
        time.sleep(0.2)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("read a file\n")
    assert re.search(r"^searching: \d+ s$", err, re.MULTILINE)
    time.sleep(0.05)
    assert capsys.readouterr().err == ""  # nothing speaks once the work is done


def test_quiet_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    with working("searching", quiet=True, verbose=True) as say:
        say("read a file")
        time.sleep(0.05)
    assert capsys.readouterr() == ("", "")


def test_verbose_says_when_and_what_it_cost(capsys: pytest.CaptureFixture[str]) -> None:
    with working("searching", quiet=False, verbose=True) as say:
        say("read a \x1b[2Jfile")
    err = capsys.readouterr().err
    assert re.search(r"^ +\d+\.\d\d s  read a \?\[2Jfile$", err, re.MULTILINE)
    assert "searching took" in err


def test_it_ends_with_the_work_that_fails() -> None:
    with pytest.raises(ValueError, match="broken"), working("searching", quiet=False):
        raise ValueError("broken")
