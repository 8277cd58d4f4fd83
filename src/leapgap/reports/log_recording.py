"""One jump, with or without ghosts beside it, as a Rerun recording."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import rerun as rr
import rerun.blueprint as rrb

from leapgap.logs.log import Log, LogInfo
from leapgap.reports.layout import jump_blueprint
from leapgap.reports.plots import NO_SUBSTITUTES, log_base, log_ground_forces, log_joints, log_phases
from leapgap.reports.recorder import Recorder, recording
from leapgap.reports.scene import FORCES, METRES_PER_NEWTON, hide_robot, log_scene
from leapgap.reports.shown_robot import ShownRobot, shown_robots
from leapgap.robot.model import Robot

NONE: Mapping[str, Log] = MappingProxyType({})


@dataclass(frozen=True)
class Further:
    """What an application adds to a recording: a tab, and what logs its entities."""

    tab: rrb.Container
    log: Callable[[Recorder, Sequence[ShownRobot]], None]


def record_jump(
    path: Path,
    jump: Log,
    robot: Robot,
    ghosts: Mapping[str, Log] = NONE,
    title: str | None = None,
    label: str = "measured",
    says: str = "",
    substitutes: Mapping[str, Sequence[tuple[float, str]]] = NO_SUBSTITUTES,
    further: Sequence[Further] = (),
) -> None:
    """Write a jump as a recording, whole or not at all.

    ``ghosts`` are other versions of the same jump by the name they are shown under, for instance
    ``{"nominal simulation": …, "corrected simulation": …}``: same robot and clock, maybe fewer rows, measured
    columns only. ``label`` names the jump itself in legends: measured, simulated, reference. ``says``
    is put in front of its notes. ``substitutes``: for each robot, by its label, times in s and reasons of fallback
    commands of its controller; each such robot gets a lane of its own and lines among the events.
    ``further`` is what an application adds.
    """
    actors = shown_robots(label, jump, ghosts, robot)
    blueprint = jump_blueprint(actors, len(substitutes), [one.tab for one in further])
    with recording(path, title or jump.name, blueprint) as to:
        log_scene(to, actors)
        end = max(actor.jump.time[-1] for actor in actors)
        for actor in actors:
            if actor.jump.time[-1] < end:
                hide_robot(to, actor, after_s=float(actor.jump.time[-1] + actor.jump.info.sample_period_s))
        log_base(to, actors)
        log_joints(to, actors)
        log_ground_forces(to, actors[0])
        log_phases(to, actors[0], substitutes)
        for one in further:
            one.log(to, actors)
        log_notes(to, actors, title or jump.name, says)


def log_notes(to: Recorder, actors: Sequence[ShownRobot], title: str, says: str = "") -> None:
    """Log the notes: what is shown, its source, and which state was not logged."""
    to.static("notes", rr.TextDocument(notes(actors, title, says), media_type=rr.MediaType.MARKDOWN))


def notes(actors: Sequence[ShownRobot], title: str, says: str = "") -> str:
    """Notes on a recording as Markdown: task, robots and their sources, terrain, arrows."""
    info = actors[0].jump.info
    lines = [f"# {title}", *([says] if says else []), *in_words(info), frame_in_words(actors[0].robot), ""]
    for actor in actors:
        role = "ghost" if actor.is_ghost else "robot"
        lines.append(
            f"- **{actor.label}** ({role}): {actor.jump.info.source}, {len(actor.jump)} rows to "
            f"{actor.jump.time[-1]:g} s"
        )
        if actor.unlogged_state:
            lines.append(f"  - not logged, shown in the model's rest pose: {'; '.join(actor.unlogged_state)}")
    for box in info.terrain:
        height = "estimated" if box.estimated else "stated"
        lines.append(f"- box on the floor at x = {box.x_m:g} m, top at {box.top_m:g} m ({height})")
    if any(actors[0].jump.has_pair_force(source) for source in FORCES):
        lines.append(
            f"- arrows at the feet: ground force on the robot planned by the MPC (red) and of the joint PD "
            f"(yellow), {100 / METRES_PER_NEWTON / 1000:g} N a 10 cm"
        )
    return "\n".join(lines) + "\n"


def frame_in_words(robot: Robot) -> str:
    """Axes and signs of what is shown of a robot."""
    frame = "World frame x forward, y left, z up"
    if not robot.has_free_base:
        return f"{frame}."
    lanes = " Contact lanes show a pair in contact as soon as one of its feet is." if robot.limbs_of_pair else ""
    return f"{frame}; pitch positive nose-down.{lanes}"


def in_words(info: LogInfo) -> list[str]:
    """Target and segments of a log, where it states them."""
    lines = []
    if "target" in info.extra:
        lines.append("Target {x_m:g} m ahead, {z_m:g} m up.".format(**info.extra["target"]))
    if info.segments:
        parts = (f"{one.name.replace('_', ' ')} from {one.begin_s:g} s" for one in info.segments)
        lines.append(f"Segments: {', '.join(parts)}.")
    return lines


GHOSTS = {"nominal": "nominal simulation", "corrected": "corrected simulation"}
"""Subfolder of a folder of replays → label of its ghost."""
JUDGED = "judged"
"""Subfolder of a folder of replays: the logs as they were judged, by their own clock where they have one."""
DIAGNOSED = "diagnosis.json"
"""File of a folder of replays: ``log`` names the jump that shows the diagnosis, ``sentence`` is its conclusion."""
