"""What a consistency check is: a question to logs that needs no fit, answered over all of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from leapgap.logs.log import Log
from leapgap.logs.row_clock import RowClock
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class CheckResult:
    """The outcome of one consistency check over all logs."""

    name: str
    passed: bool
    statistic: float
    threshold: float
    says: str
    per_log: dict[str, float]  # The statistic's estimate on each log, by the log's name
    clocks: Mapping[str, tuple[float, ...]] | None = field(default=None, repr=False)
    """True over claimed sample period of each log, where the check measures it; several where it changes within."""

    row_clocks: Mapping[str, RowClock] | None = field(default=None, repr=False)
    """When each row of each log was written, where the check finds that rows are uneven."""
    reads: Callable[[Log], Log] | None = field(default=None, repr=False)
    """How a log is to be read by what the check found, where that is not as it stands."""

    def to_json(self) -> dict[str, Any]:
        """Its entry of ``report.json``."""
        told = (entry for entry in fields(self) if entry.name not in ("clocks", "row_clocks", "reads"))
        return {entry.name: getattr(self, entry.name) for entry in told}


class Check(ABC):
    """One consistency check. A subclass in a file of this package is all that a further check takes."""

    name: ClassVar[str]
    threshold: ClassVar[float]  # The statistic up to which a check passes, where settings name no other
    place: ClassVar[int] = 100  # Checks are run, and reported, in this order
    needs_robot: ClassVar[bool] = True  # Whether the logs alone do not suffice
    needs_all_rows: ClassVar[bool] = False  # Whether the rows that are not judged tell something too
    velocities_in_time: ClassVar[bool] = False
    """Whether it judges something else than the velocity columns, which are then moved by the lag that they have."""

    @abstractmethod
    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Check all logs, cut to the rows that are judged; None where one of them lacks the columns,
        or where no log can answer.

        ``robot`` is None only where ``needs_robot`` is False and nobody named a robot.
        """


def joints_of(logs: Sequence[Log], robot: Robot | None) -> tuple[str, ...]:
    """The robot's joints in its order, or those of the first log."""
    return logs[0].joints if robot is None else robot.joints


def have_joints(logs: Sequence[Log], joints: Sequence[str]) -> bool:
    """Whether there are joints, and every log has positions and velocities of its joints."""
    return bool(joints) and all(
        f"{quantity}/{joints[0]}" in log for log in logs for quantity in ("joint_pos", "joint_vel")
    )
