"""Which test shows what each option does: read from the cases, the laws and the command tree."""

from __future__ import annotations

from options.cases import cases
from options.tree import commands, every, options_of, spellings

EACH = "test_each.py::test_the_option_does_it"
READING = "test_shared.py::test_the_reader_is_told"
#: Laws of options that every command has alike, over all commands that have them.
LAWS: dict[str, str] = {
    "--json": "test_shared.py::test_json_is_the_result_and_changes_no_file",
    "--quiet": "test_shared.py::test_quiet_prints_nothing_and_changes_no_file",
    "--force": "test_shared.py::test_another_file_is_replaced_by_force_alone",
}
GOOD = "cli/test_still_good.py"
NEXT = "cli/test_separate.py"
OWN = "cli/test_sensors.py"
#: Shown by a test of another room, which is run by its name.
ELSEWHERE: dict[tuple[str, str], str] = {
    ("batch", "--scheduler"): "cohort/test_batch.py::test_a_dask_cluster_gives_the_same",
    ("batch", "--wait"): "cohort/test_batch.py::test_a_cluster_without_workers_says_so_and_ends",
    ("check", "--limit"): f"{GOOD}::test_a_limit_that_could_not_be_seen_is_undecided_with_a_plan",
    ("check", "--noise"): f"{GOOD}::test_a_limit_that_could_not_be_seen_is_undecided_with_a_plan",
    ("check", "--sensor"): f"{GOOD}::test_a_recording_with_rests_is_a_log_too",
    (
        "check",
        "--same-device",
    ): f"{OWN}::test_a_calibration_finds_its_own_sensor_and_refuses_another",
    ("apply", "--same-device"): f"{OWN}::test_where_names_are_silent_gravity_decides",
    ("check", "--html"): f"{GOOD}::test_a_page_and_no_file_overwritten",
    ("check", "--full"): f"{GOOD}::test_a_long_result_is_one_screen_unless_all_is_shown",
    ("compare", "--full"): f"{GOOD}::test_a_long_result_is_one_screen_unless_all_is_shown",
    ("design", "--separate"): f"{NEXT}::test_a_plan_that_is_filled_in_ends_the_ambiguity",
    ("design", "--temperatures"): f"{NEXT}::test_temperatures_that_are_farther_apart_promise_more",
    ("design", "--between-sessions"): f"{NEXT}::test_another_power_up_promises_less",
    ("design", "--imu"): "calibrators/imu/test_imu.py::test_a_plan_states_what_it_gives",
    ("compare", "--limit"): f"{GOOD}::test_compare_says_what_differs",
    ("compare", "--dates"): f"{GOOD}::test_compare_says_what_differs",
    ("compare", "--html"): f"{GOOD}::test_compare_says_what_differs",
}


def reading() -> tuple[str, ...]:
    """Options that say how a recording is read."""
    from imucalib.cli.frame.options import recording

    def nothing() -> None:
        """A command without options of its own."""

    import click

    return tuple(options_of(click.command()(recording(nothing))))


def shown() -> dict[tuple[str, str], list[str]]:
    """(command, option) -> tests, empty where there is none."""
    out: dict[tuple[str, str], list[str]] = {pair: [] for pair in every()}
    names = {name: spellings(command) for name, command in commands().items()}
    for case in cases():
        option = names[case.command][case.option]
        out[case.command, option].append(f"{EACH}[{case.label}]")
    for (name, option), tests in out.items():
        if option in LAWS:
            tests.append(LAWS[option])
        if option in reading():
            tests.append(f"{READING}[{name.replace(' ', '-')}]")
        if (name, option) in ELSEWHERE:
            tests.append(ELSEWHERE[name, option])
    return out
