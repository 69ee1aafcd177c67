"""The driver of all searches, on a world of sets and what a search tells at each."""

from collections.abc import Mapping

import pytest

from imucalib.posterior.search.driver import search_until_settled


def searches(
    tells: Mapping[str, str], *, lost: str | None = None, foretold: str | None = None
) -> tuple[object, ...]:
    """What is fitted and told in the end, whether that was refused, and where searches stood; tells
    : from what is fitted to what a search tells there."""
    stood: list[str] = []

    def search(state: str) -> str:
        stood.append(state)
        return tells[state]

    def refit(_: str, found: str) -> tuple[str, bool] | None:
        return None if found == lost else (found, found == foretold)

    end = search_until_settled("", search, refit, told=str, held=str, rounds=5)
    return end.state, end.found, end.refused, "-".join(stood)


@pytest.mark.parametrize(
    ("tells", "fitted", "stood"),
    [
        ({"": ""}, "", ""),
        ({"": "a", "a": "a"}, "a", "-a"),
        ({"": "a", "a": "ab", "ab": "ab"}, "ab", "-a-ab"),
        # A round trip ends where what is told is what is fitted.
        ({"": "a", "a": "b", "b": "a"}, "a", "-a-b"),
        ({"": "a", "a": ""}, "a", "-a-"),
        # As many searches as are allowed, and the last one is fitted.
        ({"": "1", "1": "2", "2": "3", "3": "4", "4": "5", "5": "6"}, "5", "-1-2-3-4"),
    ],
)
def test_what_is_told_is_what_is_fitted(tells: dict[str, str], fitted: str, stood: str) -> None:
    assert searches(tells) == (fitted, fitted, False, stood)


def test_what_no_fit_takes_up_is_refused() -> None:
    assert searches({"": "a", "a": "ab"}, lost="ab") == ("a", "ab", True, "-a")


def test_what_stands_where_it_was_foretold_is_not_searched_again() -> None:
    assert searches({"": "a", "a": "b"}, foretold="a") == ("a", "a", False, "")


def test_what_is_told_twice_is_not_refitted_again() -> None:
    """A refit that drops what it was given is not asked once more."""
    refits: list[str] = []

    def refit(state: str, found: str) -> tuple[str, bool]:
        refits.append(found)
        return state, False

    end = search_until_settled("", lambda _: "a", refit, told=str, held=str, rounds=5)
    assert (end.state, end.found, end.refused, refits) == ("", "a", False, ["a"])
