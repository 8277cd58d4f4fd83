"""A Rerun recording, whole or not at all, on one timeline in seconds, and a robot in it: poses, label and colour."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import Poses, body_poses, configurations
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import whole_file

TIMELINE = "time"


class Recorder:
    """An open recording; every entity is either static or a set of columns over ``TIMELINE``."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self.stream = stream

    def static(self, entity: str, *what: rr.AsComponents) -> None:
        """Log what holds at all times."""
        self.stream.log(entity, *what, static=True)

    def over_time(self, entity: str, time_s: np.ndarray, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Log one row for each time, s, of an entity in a single call."""
        flat = [column for some in columns for column in some]
        self.stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=time_s)], flat)


@contextmanager
def recording(path: Path, title: str, blueprint: rrb.Blueprint) -> Iterator[Recorder]:
    """Open a recording that opens in the viewer with ``blueprint``.

    The viewer keeps one blueprint per application name, so the title is part of it: recordings opened
    together keep their own cameras and plots.
    """
    with whole_file(path) as beside:
        stream = rr.RecordingStream(f"leapgap {title}".replace(".", "-"))  # Rerun warns of names with a dot
        try:
            stream.save(beside, default_blueprint=blueprint)
            stream.send_recording_name(title)
            yield Recorder(stream)
            stream.flush()
        finally:
            stream.disconnect()


def rows_at_period(time_s: np.ndarray, period_s: float) -> np.ndarray:
    """Indices of about one row per ``period_s``, always with the first and the last row."""
    tick = np.floor((time_s - time_s[0]) / period_s + 1e-6).astype(int)
    keep = np.flatnonzero(np.diff(tick, prepend=-1) > 0)
    return np.union1d(keep, [len(time_s) - 1])


Colour = tuple[int, int, int]

MAIN: Colour = (74, 144, 255)
GHOSTS: tuple[Colour, ...] = ((255, 140, 40), (46, 190, 110), (190, 110, 240), (235, 80, 110), (120, 200, 220))
"""Colours that are legible on dark and on light; the nominal simulation gets the first, the corrected one the next."""
POSE_PERIOD_S = 0.005  # poses are drawn at up to 200 Hz


@dataclass(frozen=True)
class ShownRobot:
    """One jump with its label and colour in the recording."""

    label: str
    jump: Log
    robot: Robot
    colour: Colour
    is_ghost: bool = False

    @cached_property
    def key(self) -> str:
        """The label as one part of an entity path."""
        return "".join(c if c.isalnum() or c in "-_" else "_" for c in self.label)

    @cached_property
    def rows(self) -> np.ndarray:
        """Rows of the jump whose poses are shown."""
        return rows_at_period(self.jump.time, POSE_PERIOD_S)

    @cached_property
    def time(self) -> np.ndarray:
        """Times of the shown poses, s."""
        return self.jump.time[self.rows]

    @cached_property
    def measured_joints(self) -> tuple[str, ...]:
        """Joints of the robot whose position the log has."""
        return tuple(joint for joint in self.robot.joints if f"joint_pos/{joint}" in self.jump)

    @cached_property
    def poses(self) -> Poses:
        """Forward kinematics of the shown rows."""
        foreign = set(self.jump.joints) - set(self.robot.joints)
        if foreign:
            expected = f"joints of {self.robot.name}: {', '.join(self.robot.joints)}"
            do = "name the model this log was made with (robot.model=<model.xml>)"
            raise InputError(self.jump.name, f"joints {', '.join(sorted(foreign))}", expected, do)
        joints = self.measured_joints
        pos = self.jump.per_joint("joint_pos", joints)[self.rows] if joints else np.empty((len(self.rows), 0))
        base, quaternion = (
            self.jump.stack(columns)[self.rows] if columns[0] in self.jump else None
            for columns in (BASE_POSITION, BASE_QUATERNION)
        )
        if self.by_feet is not None:
            base = self.by_feet[self.rows]
        return body_poses(self.robot, configurations(self.robot, pos, base, quaternion, joints))

    @cached_property
    def by_feet(self) -> np.ndarray | None:
        """Position of a base that was not logged, where the feet that stand say, m, (rows, 3); None if these do not."""
        if not self.robot.has_free_base or BASE_POSITION[0] in self.jump:
            return None
        try:
            return motion_of(self.jump, self.robot).base_position
        except InputError:
            return None

    @cached_property
    def unlogged_state(self) -> tuple[str, ...]:
        """Names of the state that the log lacks; the picture takes it from the model's rest pose."""
        lacks = []
        if self.robot.has_free_base:
            for columns, what in ((BASE_POSITION, "base position"), (BASE_QUATERNION, "base orientation")):
                if columns[0] not in self.jump and (columns is not BASE_POSITION or self.by_feet is None):
                    lacks.append(what)
        unmeasured = [joint for joint in self.robot.joints if joint not in self.measured_joints]
        if unmeasured:
            lacks.append(f"joint positions of {', '.join(unmeasured)}")
        return tuple(lacks)


def shown_robots(label: str, jump: Log, ghosts: Mapping[str, Log], robot: Robot) -> tuple[ShownRobot, ...]:
    """The main robot and its ghosts, each with its colour; labels must differ."""
    actors = [ShownRobot(label, jump, robot, MAIN)]
    for i, (name, ghost) in enumerate(ghosts.items()):
        actors.append(ShownRobot(name, ghost, robot, GHOSTS[i % len(GHOSTS)], is_ghost=True))
    keys = [actor.key for actor in actors]
    if len(set(keys)) < len(keys):
        raise InputError(
            jump.name, f"robots named {', '.join(a.label for a in actors)}", "names that differ", "rename one"
        )
    return tuple(actors)
