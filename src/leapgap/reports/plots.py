"""Curves over time: the base, joints, torques and forces of the pairs; phases, contacts and events."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import rerun as rr

from leapgap.effects.motors import TorqueSpeedLimit
from leapgap.logs import state
from leapgap.logs.log import Log
from leapgap.logs.metadata import FLIGHT, LIFT_OFF_WINDOW_S, Segment
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.reports.shown_robot import Colour, Recorder, ShownRobot, rows_at_period
from leapgap.robot.model import Robot
from leapgap.robot.terrain import ground_geoms
from leapgap.robot.topology import PAIRS

BASE_PERIOD_S = 0.002
JOINT_PERIOD_S = 0.005  # of the plots: 500 Hz for the base, 200 Hz for joints and forces, about a sample per pixel
COMMAND_COLOUR: Colour = (150, 150, 150)
FORCE_COLOURS: dict[str, Colour] = {
    "mpc_force": (240, 70, 70),
    "pd_force": (240, 200, 60),
    "train_force": (74, 144, 255),
}
FOOT_COLOURS: tuple[Colour, ...] = ((74, 144, 255), (120, 200, 220), (255, 140, 40), (240, 200, 60))
PHASE_COLOURS = ((74, 144, 255), (255, 140, 40), (240, 200, 60), (150, 110, 230), (120, 126, 136), (225, 120, 190))
"""Colours of the segments of a log, in turn."""
SUBSTITUTE_COLOURS = {"substitute": (235, 80, 110), "regular": (70, 74, 84)}
HELD_S = 0.025  # period between two updates of a controller, for which a substitute command is held
LIMIT_COLOUR: Colour = (200, 60, 60)
LEAST_PUSH_N = 10.0  # vertical force of a pair from which its direction means anything
LIFT_OFF = "lift_off"  # segment of a jump about the planned take-off
PUSHING = dict.fromkeys(("rear_contact", LIFT_OFF), (False, True)) | {FLIGHT: (False, False)}
"""Segments of a jump in which not both pairs of feet are planned to push: (front, rear)."""
NO_SUBSTITUTES: Mapping[str, Sequence[tuple[float, str]]] = MappingProxyType({})
CONTACT_COLOURS = {"contact": (46, 160, 100), "air": (70, 74, 84)}


@dataclass(frozen=True)
class Component:
    """One component of the base's planar motion, in the world frame."""

    key: str
    unit: str
    needs: str  # column that a log must have for it

    @property
    def label(self) -> str:
        """Title of an axis: the name and, in brackets, the unit."""
        return f"{self.key.replace('_', ' ')} [{self.unit}]"

    def of(self, jump: Log) -> np.ndarray:
        """Its values in a log, (rows,)."""
        return jump.pitch if self.key == "pitch" else jump[self.needs]


COMPONENTS = (
    Component("x", "m", "base_pos_x"),
    Component("z", "m", "base_pos_z"),
    Component("pitch", "rad", "base_quat_w"),
    Component("vx", "m/s", "base_linvel_x"),
    Component("vz", "m/s", "base_linvel_z"),
    Component("pitch_rate", "rad/s", "base_angvel_y"),
)


def components(jump: Log) -> tuple[Component, ...]:
    """The components of the base motion that a log has."""
    return tuple(component for component in COMPONENTS if component.needs in jump)


@dataclass(frozen=True)
class Curve:
    """One line of a plot: a value for each time of the main robot's clock, NaN where there is none."""

    name: str
    colour: Colour
    values: np.ndarray


def log_plot(to: Recorder, entity: str, time_s: np.ndarray, curves: Sequence[Curve], width: float = 1.6) -> None:
    """Log curves that share their times as one entity, so that times and names are stored once."""
    if not curves:
        return
    names, colours = [curve.name for curve in curves], [curve.colour for curve in curves]
    to.static(entity, rr.SeriesLines(names=names, colors=colours, widths=[width] * len(curves)))
    values = np.stack([curve.values for curve in curves], axis=-1)
    columns = rr.Scalars.columns(scalars=values.astype(np.float32).astype(np.float64).ravel())
    to.over_time(entity, time_s, columns.partition([len(curves)] * len(time_s)))


def on_clock(time_s: np.ndarray, jump: Log, values: np.ndarray) -> np.ndarray:
    """A ghost's values at the main robot's times, NaN outside of the ghost's own."""
    return np.interp(time_s, jump.time, values, left=np.nan, right=np.nan)


def log_base(to: Recorder, actors: Sequence[ShownRobot]) -> None:
    """Log six components of every robot's base, and the residual ghost − main where both have them."""
    main = actors[0]
    time = main.jump.time[rows_at_period(main.jump.time, BASE_PERIOD_S)]
    for part in COMPONENTS:
        has = [actor for actor in actors if part in components(actor.jump)]
        curves = [Curve(a.label, a.colour, on_clock(time, a.jump, part.of(a.jump))) for a in has]
        log_plot(to, f"base/{part.key}", time, curves)
        if main in has:
            log_plot(to, f"residual/{part.key}", time, residuals(curves))


def residuals(curves: Sequence[Curve]) -> list[Curve]:
    """How far each ghost is from the main robot, whose curve is the first."""
    main, *ghosts = curves
    return [Curve(f"{one.name} − {main.name}", one.colour, one.values - main.values) for one in ghosts]


def log_joints(to: Recorder, actors: Sequence[ShownRobot]) -> None:
    """Log position and velocity of every joint, measured and commanded, and the motor torque."""
    main = actors[0]
    rows = rows_at_period(main.jump.time, JOINT_PERIOD_S)
    time = main.jump.time[rows]
    for joint in main.robot.joints:
        entity = f"joints/{main.robot.limb_of(joint)}/{joint}"
        for quantity, command in (("joint_pos", "cmd_pos"), ("joint_vel", "cmd_vel")):
            name, commanded = f"{quantity}/{joint}", f"{command}/{joint}"
            curves = [Curve(a.label, a.colour, on_clock(time, a.jump, a.jump[name])) for a in actors if name in a.jump]
            if quantity == "joint_pos" and name in main.jump:
                log_plot(to, f"{entity}/residual", time, residuals(curves))
            if commanded in main.jump:
                curves.append(Curve("command", COMMAND_COLOUR, main.jump[commanded][rows]))
            log_plot(to, f"{entity}/{quantity}", time, curves)
        curves = []
        # Feed-forward and joint PD of the log, N·m, (rows,); None where the joint was not measured
        known = all(f"{name}/{joint}" in main.jump for name in ("cmd_tau", "joint_pos", "joint_vel"))
        torque = state.commanded_torque(main.jump, (joint,))[:, 0] if known else None
        if torque is not None:
            curves.append(Curve("commanded", main.colour, torque[rows]))
        if f"tau/{joint}" in main.jump:
            curves.append(Curve("measured", COMMAND_COLOUR, main.jump[f"tau/{joint}"][rows]))
        if curves:
            low, high = torque_bounds(main.jump, joint, main.robot)
            if np.isfinite([low, high]).all():
                curves.append(Curve("upper limit of the motor", LIMIT_COLOUR, high[rows]))
                curves.append(Curve("lower limit of the motor", LIMIT_COLOUR, low[rows]))
        log_plot(to, f"{entity}/torque", time, curves)


def torque_bounds(jump: Log, joint: str, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest torque that a joint's motor can deliver at each row, N·m, (rows,); infinite without a limit.

    The model's limit, and, where the model states its motors' constants and the speed was measured, the law of
    ``torque_speed_limit`` at the logged supply voltage, or else at the one that allows full torque at top speed.
    """
    limit = float(robot.torque_limits[robot.joints.index(joint)])
    low, high = np.full(len(jump), -limit), np.full(len(jump), limit)
    motors, speed = robot.motors, f"joint_vel/{joint}"
    if motors is None or speed not in jump:
        return low, high
    (ample,) = TorqueSpeedLimit.parameters(robot)
    voltage = np.full(len(jump), ample.nominal)
    if "supply_voltage" in jump:
        voltage = jump["supply_voltage"]
    back = jump[speed]
    low = np.maximum(low, (-voltage - back) / motors.resistance)
    high = np.minimum(high, (voltage - back) / motors.resistance)
    return low, high


def log_ground_forces(to: Recorder, actor: ShownRobot) -> None:
    """Log the forces of the pairs on the robot, N, of each source that the log has; foot sensors as logged."""
    jump = actor.jump
    rows = rows_at_period(jump.time, JOINT_PERIOD_S)
    sources = [source for source in FORCE_COLOURS if jump.has_pair_force(source)]
    for axis in PAIR_FORCE_AXES:
        curves = [Curve(s, FORCE_COLOURS[s], jump[f"{s}/{axis}"][rows]) for s in sources]
        log_plot(to, f"forces/{axis}", jump.time[rows], curves)
    log_force_ratios(to, actor, sources, rows)
    sensors = [foot for foot in actor.robot.feet if f"foot_force/{foot}" in jump]
    curves = [Curve(foot, FOOT_COLOURS[i % 4], jump[f"foot_force/{foot}"][rows]) for i, foot in enumerate(sensors)]
    log_plot(to, "forces/foot_sensors", jump.time[rows], curves)


def log_force_ratios(to: Recorder, actor: ShownRobot, sources: Sequence[str], rows: np.ndarray) -> None:
    """Log |F_x| / F_z of each pair beside the friction of the ground; no ratio where hardly anything pushes."""
    jump = actor.jump
    for pair in PAIRS if sources else ():
        curves = []
        for source in sources:
            along, up = (jump[f"{source}/{pair}_{axis}"][rows] for axis in ("x", "z"))
            ratio = np.where(up > LEAST_PUSH_N, np.abs(along) / np.maximum(up, LEAST_PUSH_N), np.nan)
            curves.append(Curve(source, FORCE_COLOURS[source], ratio))
        friction = np.full(len(rows), ground_friction(actor.robot))
        log_plot(to, f"forces/ratio_{pair}", jump.time[rows], [*curves, Curve("friction", LIMIT_COLOUR, friction)])


def ground_friction(robot: Robot) -> float:
    """Sliding friction between feet and floor: the larger of the two, as MuJoCo combines them."""
    model = robot.model
    return float(model.geom_friction[[*robot.foot_geoms, *ground_geoms(model)], 0].max())


def log_phases(
    to: Recorder, actor: ShownRobot, substitutes: Mapping[str, Sequence[tuple[float, str]]] = NO_SUBSTITUTES
) -> None:
    """Log planned phases, measured contacts of the pairs and fallback commands as lanes, and events as text.

    ``substitutes``: for each controller, by its robot's label, times in s and reasons of its fallback commands.
    """
    jump = actor.jump
    segments = [segment for segment in jump.info.segments if segment.begin_s < jump.time[-1]]
    names = [segment.name.replace("_", " ") for segment in segments]
    if segments:
        unique = list(dict.fromkeys(names))
        colours = {name: PHASE_COLOURS[k % len(PHASE_COLOURS)] for k, name in enumerate(unique)}
        log_lane(to, "phases/planned", np.array([segment.begin_s for segment in segments]), names, colours)
    for place, pair in enumerate(PAIRS):
        if pair in switched_pairs(actor) and segments:
            parts = split_at_take_off(segments)
            states = ["contact" if planned_to_push(part)[place] else "air" for part in parts]
            log_lane(to, f"phases/plan_{pair}", np.array([one.begin_s for one in parts]), states, CONTACT_COLOURS)
    for pair in switched_pairs(actor):
        closed = np.any([jump[f"contact/{foot}"] > 0 for foot in actor.robot.feet_of_pair(pair)], axis=0)
        changes = np.flatnonzero(np.diff(closed.astype(int), prepend=2))
        states = ["contact" if closed[row] else "air" for row in changes]
        log_lane(to, f"phases/switch_{pair}", jump.time[changes], states, CONTACT_COLOURS)
    events = [(one.begin_s, f"{name} begins") for one, name in zip(segments, names, strict=True) if one.begin_s > 0]
    if jump.rows_before_gain_change < len(jump):
        events.append((float(jump.time[jump.rows_before_gain_change]), "joint gains change"))
    for label, times_and_reasons in substitutes.items():
        log_substitutes(to, label, [time_s for time_s, _ in times_and_reasons])
        events += [(time_s, f"{label}: substitute, {reason}") for time_s, reason in times_and_reasons]
    events = sorted(event for event in events if event[0] <= jump.time[-1])
    if events:
        times, texts = zip(*events, strict=True)
        to.over_time("events", np.array(times), rr.TextLog.columns(text=list(texts), level=["INFO"] * len(texts)))


def planned_to_push(segment: Segment) -> tuple[bool, bool]:
    """Whether the front and the rear pair are planned to push in a segment; both where its name says nothing else."""
    return PUSHING.get(segment.name, (True, True))


def split_at_take_off(segments: Sequence[Segment]) -> list[Segment]:
    """The segments of a log; of ``lift_off``, which lies about the take-off, the second half counts as flight."""
    parts: list[Segment] = []
    for one in segments:
        if one.name == LIFT_OFF:
            take_off_s = one.begin_s + LIFT_OFF_WINDOW_S
            parts += [Segment(LIFT_OFF, one.begin_s, take_off_s), Segment(FLIGHT, take_off_s, one.end_s)]
        else:
            parts.append(one)
    return parts


def log_substitutes(to: Recorder, label: str, times_s: Sequence[float]) -> None:
    """Log a lane of the fallback commands of a controller; each is held until the next update."""
    changes = {0.0: "regular", **{time_s + HELD_S: "regular" for time_s in times_s}}
    changes |= dict.fromkeys(times_s, "substitute")
    at = sorted(changes)
    log_lane(to, f"phases/{label}", np.array(at), [changes[time_s] for time_s in at], SUBSTITUTE_COLOURS)


def switched_pairs(actor: ShownRobot) -> tuple[str, ...]:
    """Pairs of feet whose measured contacts the log has."""
    feet_of = {pair: actor.robot.feet_of_pair(pair) for pair in PAIRS}
    return tuple(p for p, feet in feet_of.items() if feet and all(f"contact/{f}" in actor.jump for f in feet))


def log_lane(to: Recorder, entity: str, times: np.ndarray, states: Sequence[str], colours: dict[str, Colour]) -> None:
    """Log one lane of the state timeline: the state from each time on."""
    to.static(entity, rr.StateConfiguration(values=list(colours), labels=list(colours), colors=list(colours.values())))
    to.over_time(entity, times, rr.StateChange.columns(state=list(states)))
