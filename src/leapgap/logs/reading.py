"""Many logs at once: those that cannot be used are set aside with their reasons, and the rest goes on."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError, printable
from leapgap.logs.consistency import remarks
from leapgap.logs.files import check_folder, check_tree, decoding
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.log import Log, check_read, log_files, read_log
from leapgap.logs.state import check_logged
from leapgap.robot.model import Robot

FEWEST = 2  # logs that must be left where others were set aside
OUTSIDE = 0.5  # share of the rows in which a joint may be far outside its range: more is another unit or another joint


@dataclass(frozen=True)
class SetAside:
    """A log that was left out, and why."""

    name: str
    reason: str

    def __str__(self) -> str:
        """One line for a person."""
        return f"set aside {self.name}: {self.reason}"


@dataclass(frozen=True)
class Readings:
    """Logs that were read, and those that were set aside."""

    logs: tuple[Log, ...]
    set_aside: tuple[SetAside, ...] = ()

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What is unusual in the logs that were read: gaps in time, rows that repeat."""
        return tuple(f"{log.name}: {remark}" for log in self.logs for remark in remarks(log.columns))

    def lines(self) -> list[str]:
        """What a person should know of the logs: those set aside, and what is unusual in the others."""
        return [*map(str, self.set_aside), *self.notes]


def read_folder(folder: Path, robot: Robot | None = None) -> Readings:
    """Logs in leapgap's format in a folder, in the order of their names; none where there is no file.

    With a robot, those that are not of that robot are set aside, too. ``InputError`` lists all bad logs where fewer
    than two others are left.
    """

    def read(path: Path) -> list[Log]:
        log = read_log(path)
        if robot is not None:
            check_logged(log, robot)
            check_joints(log, robot)
        return [log]

    readings = collect(folder, ((path.name, partial(read, path)) for path in log_files(folder)))
    if robot is None or not any(log.info.robot == robot.name for log in readings.logs):
        return readings
    # Without logs of other robots, where some state that they are of this one
    own = [log for log in readings.logs if log.info.robot == robot.name]
    others = [
        (f"{log.name}.parquet", InputError(log.name, f"robot {log.info.robot}", robot.name, "keep robots apart"))
        for log in readings.logs
        if log.info.robot != robot.name
    ]
    found = enough(folder, own, others)
    return Readings(found.logs, (*readings.set_aside, *found.set_aside))


def read_foreign(layout: LogFormat, source: Path, robot: Robot, options: Any) -> Readings:
    """Logs of another format, of a file or below a folder; ``InputError`` as in ``read_folder``."""

    def read(path: Path, name: str) -> list[Log]:
        check_tree(path, f"a log of format {layout.name}", "copy the files themselves")
        with decoding(path, layout.name, "export it again"):
            logs = layout.read_all(path, name, robot, options)
        for log in logs:
            check_read(log, f"{path}, {log.name}" if len(logs) > 1 else path)
            check_joints(log, robot)
        return logs

    if source.is_dir():
        check_folder(source)
    return collect(source, ((name, partial(read, path, name)) for name, path in layout.find(source).items()))


def collect(source: Path, readers: Iterable[tuple[str, Callable[[], list[Log]]]]) -> Readings:
    """Call each reader; those that refuse are set aside, if enough are left."""
    logs: list[Log] = []
    errors: list[tuple[str, InputError]] = []
    for name, read in readers:
        try:
            logs += read()
        except InputError as error:
            errors.append((name, error))
    return enough(source, logs, errors)


def enough(source: Path, logs: Sequence[Log], errors: Sequence[tuple[str, InputError]]) -> Readings:
    """The readings; ``InputError`` with all reasons where logs were set aside and fewer than two are left."""
    if errors and len(logs) < FEWEST:
        if not logs and len({str(error) for _, error in errors}) == 1:
            raise errors[0][1]
        raise InputError(
            source,
            f"{len(errors)} of {len(errors) + len(logs)} logs that cannot be used",
            f"{FEWEST} logs or more that can be used",
            "repair or remove those",
            (f"{name}: {error}" for name, error in errors),
        )
    return Readings(tuple(logs), tuple(SetAside(printable(name), str(error)) for name, error in errors))


def check_joints(log: Log, robot: Robot) -> None:
    """``InputError`` where a joint is most of the time further outside its range than the range is wide."""
    for joint in robot.joints:
        at = robot.model.joint(joint).id
        if not robot.model.jnt_limited[at] or f"joint_pos/{joint}" not in log:
            continue
        low, high = robot.model.jnt_range[at]
        position, wide = log[f"joint_pos/{joint}"], high - low
        if np.mean((position < low - wide) | (position > high + wide)) > OUTSIDE:
            found = f"{np.median(position):.3g} in the middle of its rows"
            expected = f"{low:.3g} to {high:.3g}, as {robot.name} has it"
            do = "correct its unit (degrees?), its zero, or the order of the joints"
            raise InputError(f"{log.name}, column joint_pos/{joint}", found, expected, do)
