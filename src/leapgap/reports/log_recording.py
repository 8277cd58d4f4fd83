"""One jump, with or without ghosts beside it, as a Rerun recording, and the views that it opens with."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from leapgap.logs.log import Log, LogInfo
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.reports.plots import (
    COMPONENTS,
    FORCE_COLOURS,
    NO_SUBSTITUTES,
    components,
    log_base,
    log_ground_forces,
    log_joints,
    log_phases,
    switched_pairs,
)
from leapgap.reports.scene import FORCES, METRES_PER_NEWTON, WORLD, extent, hide_robot, log_scene
from leapgap.reports.shown_robot import TIMELINE, Recorder, ShownRobot, recording, shown_robots
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS

PLAYBACK_SPEED = 0.25  # of real time, since a jump takes only 1.2 s
BACKGROUND = (44, 48, 56)
POSE = ("x", "z", "pitch")
MOST_JOINTS = 8  # number of joints that are shown beside the scene of a robot without a base state


def add_panels(root: rrb.Container) -> rrb.Blueprint:
    """Complete a blueprint: collapsed side panels, and the time in seconds at the bottom."""
    return rrb.Blueprint(
        root,
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, playback_speed=PLAYBACK_SPEED, play_state="paused", loop_mode="all"
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def overview(actors: Sequence[ShownRobot], plots: rrb.Container, extra_lanes: int = 0) -> rrb.Container:
    """Scene, plots and phases on one page."""
    log, pairs = actors[0].jump, len(switched_pairs(actors[0]))
    name = "Jump" if "target" in log.info.extra else "Overview"
    above = rrb.Horizontal(scene_view(actors), plots, column_shares=[1.1, 1.0], name=name)
    if not (log.info.segments or pairs or extra_lanes):
        return above
    return rrb.Vertical(
        above,
        rrb.StateTimelineView(origin="phases", name="Phases planned, contacts measured" if pairs else "Segments"),
        row_shares=[1.0, 0.1 + 0.055 * (1 + 2 * pairs + extra_lanes)],
        name=name,
    )


def scene_view(actors: Sequence[ShownRobot]) -> rrb.View:
    """The 3-D scene from the robot's right-hand side, far enough to see the whole jump."""
    low, high = extent(actors)
    middle = (low + high) / 2
    distance = 0.45 + 0.85 * max(high[0] - low[0], 1.3 * (high[2] - low[2]))
    eye = middle + distance * np.array([0.16, -1.0, 0.2])
    return rrb.Spatial3DView(
        origin=WORLD,
        name="Scene",
        background=BACKGROUND,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0.0, 0.0, 1.0)),
    )


def plot(origin: str, name: str, legend: bool = False) -> rrb.View:
    """View of curves over the whole jump; the legend is optional, since it covers part of the curves."""
    corner = rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend)
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=corner)


def base_plots(actors: Sequence[ShownRobot]) -> rrb.Container:
    """Plots of the base: pose beside its residual, velocities in a second tab; without ghosts, all on one page."""
    main = actors[0]
    shown = [part for part in COMPONENTS if any(part in components(actor.jump) for actor in actors)]
    if not shown:
        # Positions of the first joints, for logs without a base state; the tab of the joints has all of them
        joints = main.robot.joints[:MOST_JOINTS]
        of_limb = [(main.robot.limb_of(joint), joint) for joint in joints]
        views = [
            plot(f"joints/{limb}/{joint}/joint_pos", f"{joint} position [rad]", legend=joint == joints[0])
            for limb, joint in of_limb
        ]
        return rrb.Grid(*views, grid_columns=2 if len(views) > 3 else 1, name="Joint positions")
    with_legend = (shown[0], *shown[3:4])
    values = {p.key: plot(f"base/{p.key}", p.label, p in with_legend) for p in shown}
    if len(actors) == 1:
        return rrb.Grid(*values.values(), grid_columns=2 if len(shown) > 3 else 1, name="Base")
    measured = components(main.jump)
    residuals = {
        part.key: plot(f"residual/{part.key}", f"Δ {part.label}, ghost − {main.label}")
        for part in shown
        if part in measured
    }
    pages = []
    for name, keys in (
        ("Base pose", [part.key for part in shown if part.key in POSE]),
        ("Base velocity", [part.key for part in shown if part.key not in POSE]),
    ):
        if keys:
            views = [of[key] for key in keys for of in (values, residuals) if key in of]
            pages.append(rrb.Grid(*views, grid_columns=2, name=name))
    return rrb.Tabs(*pages, active_tab=0)


def leg(actor: ShownRobot, name: str, residual: bool = False) -> rrb.Container:
    """Position, velocity and torque of a leg's joints, a column each; with ghosts, what their positions differ by."""
    joints = [joint for joint in actor.robot.joints if actor.robot.limb_of(joint) == name]
    rows = [("joint_pos", "position [rad]"), ("joint_vel", "velocity [rad/s]"), ("torque", "torque [N·m]")]
    if residual:
        rows.append(("residual", f"Δ position [rad], ghost − {actor.label}"))
    views = [
        plot(f"joints/{name}/{joint}/{quantity}", f"{joint} {label}", legend=joint == joints[0])
        for quantity, label in rows
        for joint in joints
    ]
    return rrb.Grid(*views, grid_columns=len(joints), name=name)


NONE: Mapping[str, Log] = MappingProxyType({})


def record_jump(
    path: Path,
    jump: Log,
    robot: Robot,
    ghosts: Mapping[str, Log] = NONE,
    title: str | None = None,
    label: str = "measured",
    says: str = "",
    substitutes: Mapping[str, Sequence[tuple[float, str]]] = NO_SUBSTITUTES,
) -> None:
    """Write a jump as a recording, whole or not at all.

    ``ghosts`` are other versions of the same jump by the name they are shown under, for instance
    ``{"nominal simulation": …, "corrected simulation": …}``: same robot and clock, maybe fewer rows, measured
    columns only. ``label`` names the jump itself in legends: measured, simulated, reference. ``says``
    is put in front of its notes. ``substitutes``: for each robot, by its label, times in s and reasons of fallback
    commands of its controller; each such robot gets a lane of its own and lines among the events.
    """
    actors = shown_robots(label, jump, ghosts, robot)
    # Scene on the left, base and residuals on the right, phases below; joints, forces and notes in tabs
    main = actors[0]
    tabs: list[rrb.Container | rrb.View] = [overview(actors, base_plots(actors), len(substitutes))]
    legs = dict.fromkeys(map(main.robot.limb_of, main.robot.joints))
    tabs.append(rrb.Tabs(*[leg(main, name, len(actors) > 1) for name in legs], name="Joints"))
    forces = []
    if any(main.jump.has_pair_force(source) for source in FORCE_COLOURS):
        for axis in PAIR_FORCE_AXES:
            forces.append(
                plot(f"forces/{axis}", f"{axis.replace('_', ' feet, ')} [N]", legend=axis == PAIR_FORCE_AXES[0])
            )
        for pair in PAIRS:
            forces.append(plot(f"forces/ratio_{pair}", f"{pair} feet, |F_x| / F_z", legend=pair == PAIRS[0]))
    if any(f"foot_force/{foot}" in main.jump for foot in main.robot.feet):
        forces.append(plot("forces/foot_sensors", "foot sensors [as logged]", legend=True))
    if forces:
        tabs.append(rrb.Grid(*forces, grid_columns=2, name="Ground forces on the robot"))
    tabs.append(
        rrb.Horizontal(
            rrb.TextDocumentView(origin="notes", name="Notes"),
            rrb.TextLogView(origin="events", name="Events"),
            name="Notes",
        )
    )
    blueprint = add_panels(rrb.Tabs(*tabs, active_tab=0))
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
        if actor.by_feet is not None:
            lines.append("  - position of the base not logged, shown where the feet that stand say")
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


GHOSTS = {"nominal": "nominal simulation", "corrected": "corrected simulation"}  # subfolder of replays → ghost
JUDGED = "judged"  # subfolder of a folder of replays: the logs as judged, by their own clock where they have one
DIAGNOSED = "diagnosis.json"
"""File of a folder of replays: ``log`` names the jump that shows the diagnosis, ``sentence`` is its conclusion."""
