"""The page of a cohort: flagged recordings first, nothing from outside, small also with many."""

from __future__ import annotations

import re
from typing import Any

from imucalib.report.cohort import cohort_html

MOST_BYTES = 2_000_000  # of a page with a thousand recordings


def row(name: str, code: int = 0, after: float | None = 1.0, **more: Any) -> dict[str, Any]:
    """What a table holds of one recording."""
    found = {
        "recording": f"/data/site/{name}",
        "use": "care" if code else "use",
        "why": "",
        "error_unit": "mg",
        "error_before": 30.0,
        "error_after": after,
        "hours_worn": 20.0,
    }
    return found | more


def failed(name: str) -> dict[str, Any]:
    return {"recording": name, "use": "do not", "why": "it is empty. copy it"}


def names_of(page: str) -> list[str]:
    return re.findall(r"</span>([^<]*)</td>", page)


def test_flagged_recordings_come_first_and_then_the_largest_errors() -> None:
    table = (row("a.csv"), row("b.csv", after=3.0), row("c.csv", 5), failed("d.csv"))
    page = cohort_html(table, "cohort")
    assert names_of(page) == ["d.csv", "c.csv", "b.csv", "a.csv"]
    assert "4 recordings: 2 to use, 1 with care, 1 not." in page
    assert "it is empty. copy it" in page


def test_a_cautioned_recording_is_flagged_with_its_reason_in_sight() -> None:
    doubted = row("b.csv", 1, why="known to 3.6 mg only")
    page = cohort_html((row("a.csv"), doubted), "cohort")
    assert names_of(page) == ["b.csv", "a.csv"]
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page)
    assert cells[2] == "known to 3.6 mg only"  # before the numbers, which a narrow window cuts off


def test_what_to_do_stands_beside_why_once_and_commands_are_set_as_such() -> None:
    why, step = "known to 3.6 mg only", "record more nights"
    page = cohort_html(
        (
            row("a.csv", 1, why=why, what_to_do=step),
            failed("b.csv") | {"why": "never still. `imucal inspect` shows it"},
            failed("c.csv") | {"what_to_do": "copy it"},
        ),
        "cohort",
    )
    said = re.findall(r'<td class="do">(.*?)</td>', page)
    assert said[2] == f"{why}. {step}"
    assert said[0] == "never still. <code>imucal inspect</code> shows it"
    assert said[1] == "it is empty. copy it"


def test_a_count_has_all_its_digits() -> None:
    page = cohort_html((row("a.csv", posture_runs=1768, enmo_before_mg=41.23),), "cohort")
    assert re.findall(r'<td class="r">(.*?)</td>', page) == ["30", "1", "20", "1768", "41.2"]


def test_a_cohort_of_failures_and_of_one_have_a_page() -> None:
    assert names_of(cohort_html((failed("d.csv"),), "c")) == ["d.csv"]
    assert names_of(cohort_html((row("a.csv", after=None),), "c")) == ["a.csv"]


def test_names_are_text_and_nothing_is_loaded() -> None:
    hostile = "<img src=x onerror=alert(1)>.csv"
    page = cohort_html((row("a.csv", why=hostile), failed(hostile)), hostile)
    assert "<img" not in page
    assert page.count("<script") == 1
    assert not re.search(r"""(src|href)=["'](?!#)|url\(|@import|https?://(?!www\.w3\.org)""", page)


def test_a_thousand_recordings_fit() -> None:
    words = "record longer, turn the wrist so that z points up and down, and keep it still. " * 3
    table = tuple(
        row(f"subject_{k:04d}_week_1_left_wrist.cwa", k % 2, 1.0 + k, why=words,
            posture_runs=123)
        for k in range(1000)
    )  # fmt: skip
    page = cohort_html(table, "a study")
    assert len(names_of(page)) == 1000
    assert len(page.encode()) <= MOST_BYTES
