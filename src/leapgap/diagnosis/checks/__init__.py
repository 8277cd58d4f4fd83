"""Consistency before physics: what a log must satisfy by itself. A file a check, found by its class.

A fault of measurement that passes unnoticed is absorbed by every later fit; these checks need no fitted model.
"""

import sys
from collections.abc import Mapping, Sequence
from functools import cache

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.diagnosis.checks.velocity_channel import columns_of
from leapgap.logs.log import Log
from leapgap.logs.row_clock import RowClock
from leapgap.logs.velocity_channel import in_time
from leapgap.registry import classes_by_name
from leapgap.robot.model import Robot

ENTRY_POINTS = "leapgap.checks"  # Group under which other packages offer checks


@cache
def known() -> tuple[type[Check], ...]:
    """All checks, in the order in which they are told."""
    kinds = classes_by_name(sys.modules[__name__], Check, ENTRY_POINTS)  # type: ignore[type-abstract]
    return tuple(sorted(kinds.values(), key=lambda kind: (kind.place, kind.name)))


def run_checks(
    logs: Sequence[Log], robot: Robot | None, thresholds: Mapping[str, float], whole: Sequence[Log] | None = None
) -> list[CheckResult]:
    """The checks that the logs have columns for; ``thresholds`` by name stand in place of the checks' own.

    ``whole`` are the same logs with all their rows, where ``logs`` are cut. Without a robot only those that need none;
    where velocities are off in ways of their own, only those that do not rely on them.
    """
    usable = [kind() for kind in known() if robot is not None or not kind.needs_robot]
    columns = {log.name: columns_of(log, robot) for log in whole or logs}
    if any(column.rest > 0 for of_log in columns.values() for column in of_log.values()):
        usable = [check for check in usable if not check.velocities_in_time]
    timed = {log.name: in_time(log, columns[log.name]) for log in whole or logs}
    results = []
    for check in usable:
        asked = whole if check.needs_all_rows and whole else logs
        if check.velocities_in_time:
            asked = [timed[log.name].first_rows(len(log)) for log in asked]
        results.append(check.run(asked, robot, thresholds.get(check.name, check.threshold)))
    return [result for result in results if result is not None]


def as_read(logs: Sequence[Log], results: Sequence[CheckResult]) -> list[Log]:
    """The logs as checks say that they are to be read; the same logs where all stand as they are."""
    found = list(logs)
    for result in results:
        if result.reads is not None:
            found = [result.reads(log) for log in found]
    return found


def row_clocks_of(results: Sequence[CheckResult]) -> Mapping[str, RowClock] | None:
    """When each row of each log was written, where its rows are uneven in a way that its time does not say."""
    return next((result.row_clocks for result in results if result.row_clocks), None)


def clock_of(results: Sequence[CheckResult]) -> Mapping[str, tuple[float, ...]] | None:
    """True over claimed period of each log, by the most detailed check of it that failed; None where none did.

    The joints are not scored in the headline gap of a robot with a base, so this holds on held-out logs too.
    """
    failed = {result.name: result.clocks for result in results if not result.passed}
    return failed.get("even_clock") or failed.get("joint_clock")
