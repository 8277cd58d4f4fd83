"""Are the joints' velocity columns those of their positions, in time and as fine as these?"""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints, joints_of
from leapgap.logs.log import Log
from leapgap.logs.state import fit_window_s
from leapgap.logs.velocity_channel import FILTERED, UNCLEAR, VelocityColumn, in_time, velocity_columns, without
from leapgap.robot.model import Robot
from leapgap.simulation.rollout_models import own_lag_s

LAG = ("late_s", "error_s")


class VelocityChannel(Check):
    """A late, filtered or coarse velocity is worse than one fitted through the positions.

    The statistic is the error that lag and ticks make of a reported velocity, over the larger of its noise and the
    error of one fitted through positions, of the worst joint; the median of the logs. Where the check fails, the
    velocities of such joints are left out, and fitted where replays begin; those that are late by half a row alone, as
    differences of two rows are, are moved.
    """

    name = "velocity_channel"
    threshold = 1.0
    place = -1
    needs_robot = False
    needs_all_rows = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Find lag and ticks of each joint's velocity column in each log."""
        if not have_joints(logs, joints_of(logs, robot)):
            return None
        found = {log.name: columns for log in logs if (columns := columns_of(log, robot))}
        if not found:
            return None
        joints: dict[str, list[VelocityColumn]] = {}
        for columns in found.values():
            for joint, column in columns.items():
                joints.setdefault(joint, []).append(column)
        worst = {name: max(map(ratio, columns.values())) for name, columns in found.items()}
        statistic = float(np.median(list(worst.values())))
        bad = {
            joint: columns
            for joint, columns in joints.items()
            if float(np.median([ratio(column) for column in columns])) > threshold
        }
        if not bad:
            statistic = min(statistic, threshold)
            says = "joint velocities match the derivative of the positions, without delay"
            return CheckResult(self.name, True, statistic, threshold, f"{says}{ticks_in_words(joints)}", worst)
        moved = tuple(joint for joint, columns in bad.items() if all(column.of_two_rows for column in columns))
        left_out = tuple(joint for joint in bad if joint not in moved)
        goes_on = []
        if moved:
            goes_on.append(f"{in_words({joint: bad[joint] for joint in moved})}, and are moved by it")
        if left_out:
            fitted = "the diagnosis goes on with velocities fitted through the positions of these joints"
            goes_on.append(f"{in_words({joint: bad[joint] for joint in left_out})}; {fitted}")
        says, reads = "; ".join(goes_on), partial(as_told, columns=found, moved=moved, left_out=left_out)
        return CheckResult(self.name, False, statistic, threshold, says, worst, reads=reads)


def columns_of(log: Log, robot: Robot | None) -> dict[str, VelocityColumn]:
    """What each joint's velocity column of a log is, beside those of simulations of the robot."""
    own = 0.0 if robot is None else own_lag_s(log, robot)
    return velocity_columns(log, joints_of([log], robot), fit_window_s(log), own)


def as_told(
    log: Log, columns: Mapping[str, Mapping[str, VelocityColumn]], moved: Sequence[str], left_out: Sequence[str]
) -> Log:
    """The log with some velocities where they belong in time, and without others."""
    own = columns.get(log.name, {})
    return without(in_time(log, {joint: own[joint] for joint in moved if joint in own}), left_out)


def ratio(column: VelocityColumn) -> float:
    """Error of a reported velocity over that of one fitted through positions, or over its own noise."""
    return column.error / max(column.error_if_derived, column.noise, np.finfo(float).tiny)


def in_words(bad: Mapping[str, Sequence[VelocityColumn]]) -> str:
    """What is wrong with the velocities of some joints."""
    late = {joint: of for joint, columns in bad.items() if (of := [c for c in columns if c.late_s > 0])}
    late = {joint: of for joint, of in late.items() if 2 * len(of) > len(bad[joint])}
    scaled = {joint: float(np.median([column.scale for column in columns])) for joint, columns in bad.items()}
    scaled = {joint: scale for joint, scale in scaled.items() if scale != 1}
    others = {joint: columns for joint, columns in bad.items() if joint not in late and joint not in scaled}
    coarse = [joint for joint, columns in others.items() if any(column.tick > 0 for column in columns)]
    apart = {joint: columns for joint, columns in others.items() if joint not in coarse}
    said = []
    if late:
        lags, errors = ([1000 * float(np.median([getattr(c, of) for c in own])) for own in late.values()] for of in LAG)
        kinds = {column.kind for columns in late.values() for column in columns}
        kind = kinds.pop() if len(kinds) == 1 else UNCLEAR
        by = "with a time constant of" if kind == FILTERED else "by"
        about = f"{min(lags):.3g}" if max(lags) - min(lags) < 0.5 else f"{min(lags):.3g} to {max(lags):.3g}"
        said.append(f"velocities of {', '.join(late)} are {kind} {by} {about} ms (± {max([*errors, 0.1]):.1g})")
    said += [
        f"{joint} moves {scale:.2g} times as far as its velocities say, the other joints as far as theirs: two units"
        for joint, scale in scaled.items()
    ]
    if coarse:
        tick = max(column.tick for joint in coarse for column in bad[joint])
        said.append(f"velocities of {', '.join(coarse)} come in steps of {tick:.2g} a second")
    if apart:
        most = max(float(np.median([column.rest for column in columns])) for columns in apart.values())
        said.append(
            f"velocities of {', '.join(apart)} are {most:.2g} a second (rms) off the derivative of the positions, "
            "far more than their noise: coarse, filtered, or not of the same instant"
        )
    return "; ".join(said)


def ticks_in_words(joints: Mapping[str, Sequence[VelocityColumn]]) -> str:
    """The coarsest steps of positions and velocities, where they are what limits them."""
    columns = [column for of_joint in joints.values() for column in of_joint]
    coarse = [column for column in columns if column.tick / np.sqrt(12) > column.noise]
    if not coarse:
        return ""
    velocity, position = max(column.tick for column in coarse), max(column.position_tick for column in coarse)
    return f"; they come in steps of {velocity:.2g} a second, positions in steps of {position:.2g}"
