"""Base class of effects: what the nominal robot leaves out, with location, parameters and change of the simulation."""

import threading
from abc import ABC
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from functools import cache, cached_property
from typing import Any, ClassVar

import mujoco
import numpy as np

from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


@dataclass(frozen=True)
class Parameter:
    """One number of an effect at one robot and place: its unit, the value that changes nothing, the range searched."""

    name: str
    unit: str
    nominal: float
    """The value at which the effect is absent: 0 of what is added, 1 of a factor, or the model's own value."""
    lower: float
    upper: float
    moderate: float
    """A value whose influence on the motion is noticeable; signatures are taken and searches begin there."""
    scale: float = 1.0
    """One unit of the model's own, in the unit of the parameter: its armature, its friction, the mass of its trunk.

    1 where the model has nothing of the kind (a factor, a length, a delay), 0 where the model's own is zero.
    """
    lower_is_physical: bool = False
    """Whether ``lower`` is a physical limit (zero friction), so that a fit may end there."""
    logarithmic: bool = False
    """Whether its natural scale is logarithmic, as that of a factor which may be a fiftieth or fifty; ``lower`` > 0."""


@dataclass(frozen=True)
class Declaration:
    """Declaration of a parameter by a field of an effect's class, for any robot."""

    nominal: float | None  # ``None``: the model's own value
    unit: str
    lower: float
    upper: float
    moderate: float | None
    limits: tuple[float, float]  # Range of values that may be set
    logarithmic: bool = False  # As in ``Parameter``


def parameter(
    nominal: float | None,
    unit: str,
    lower: float,
    upper: float,
    moderate: float | None = None,
    limits: tuple[float, float] | None = None,
    logarithmic: bool = False,
) -> Any:
    """Declare a dataclass field as a parameter; its default is the value at which the effect is absent.

    ``None`` as nominal value means the model's own: the class then says in ``Effect.parameters`` what that is on a
    robot. ``lower`` to ``upper`` is the range that is searched; ``limits`` is the range of values that may be set
    (by default the same). ``logarithmic`` as in ``Parameter``.
    """
    if moderate is None and nominal is not None:
        moderate = nominal + max(upper - nominal, lower - nominal, key=abs) / 10
    about = Declaration(nominal, unit, lower, upper, moderate, limits or (lower, upper), logarithmic)
    return field(default=nominal, metadata={PARAMETER: about})


PARAMETER = "parameter"  # key of a dataclass field's metadata under which its declaration stands


class CommandStage(IntEnum):
    """Stages of a command on its way to the joints, in the order of time."""

    CHOICE = 0  # Which command holds in a row; there is one for each row, however long it lasts
    SENDING = 1  # When within its row a command is sent
    ARRIVAL = 2  # What holds at the joints at each time, whatever row it was sent in


@dataclass(frozen=True)
class Commands:
    """Commands that are sent to the joints in periods of equal length: (periods, joints), joint order of the robot."""

    torque: np.ndarray  # Feed-forward, N·m
    position: np.ndarray  # Set point of the joint PD, rad
    velocity: np.ndarray  # Set point of the joint PD, rad/s
    row: np.ndarray | None = None
    """Row of the log in which each period lies, (periods,); None: each is a row of its own."""

    @property
    def newest(self) -> "Commands":
        """The commands of the last period, as they would be without its predecessors."""
        return self.each(lambda sent: sent[-1:])

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> "Commands":
        """What a change makes of each quantity, without its rows."""
        return Commands(change(self.torque), change(self.position), change(self.velocity))


@dataclass(frozen=True)
class Load:
    """What the joints carry in steps of equal length, by the commands and the motion: (steps, joints) each."""

    torque: np.ndarray  # Of the motors, joint PD included, within their limits, N·m
    velocity: np.ndarray  # Of the joints, rad/s
    step_s: float  # Step of the simulation, s


SMALL = 0.01  # departure from nominal by which derivatives are taken, as a share of the moderate one
ACTING = (
    *("change_period", "change_rows", "change_step", "change_drive", "change_model", "change_spec"),
    *("change_commands", "torque_by_velocity", "put_controls"),
)
"""Methods by which an effect changes the true motion."""


@dataclass(frozen=True)
class ForceContext:
    """A motion of the nominal robot, step by step, along which effects state what they add to first order.

    Each step begins in its state, and the commands hold throughout it.
    """

    robot: Robot
    model: mujoco.MjModel  # The nominal model; not to be changed
    qpos: np.ndarray  # (steps, nq)
    qvel: np.ndarray  # (steps, nv)
    qacc: np.ndarray  # (steps, nv): what the velocity changes by in the step, over its length
    commands: Commands  # As they were sent, (steps, joints) each
    kp: np.ndarray  # Gain of the joint PD, N·m/rad, (steps, joints)
    kd: np.ndarray  # N·m·s/rad, (steps, joints)
    step_s: float

    @cached_property
    def position(self) -> np.ndarray:
        """Of the joints, rad, (steps, joints)."""
        return self.qpos[:, self.robot.joint_qpos]

    @cached_property
    def velocity(self) -> np.ndarray:
        """Of the joints, rad/s, (steps, joints)."""
        return self.qvel[:, self.robot.joint_dofs]

    @cached_property
    def acceleration(self) -> np.ndarray:
        """Of the joints, rad/s², (steps, joints)."""
        return self.qacc[:, self.robot.joint_dofs]

    def torque_of(self, commands: Commands) -> np.ndarray:
        """Torque by commands alone, τ + kp q* + kd q̇*, N·m, (steps, joints)."""
        return np.asarray(commands.torque + self.kp * commands.position + self.kd * commands.velocity)

    @cached_property
    def sent(self) -> np.ndarray:
        """The same by those that were sent."""
        return self.torque_of(self.commands)

    @cached_property
    def asked(self) -> np.ndarray:
        """Torque that is asked of the motors, joint PD included, before any limit, N·m, (steps, joints)."""
        return np.asarray(self.sent - self.kp * self.position - self.kd * self.velocity)

    @cached_property
    def torque(self) -> np.ndarray:
        """The same within the limits of the model."""
        limits = self.robot.torque_limits
        return np.asarray(np.clip(self.asked, -limits, limits))

    @cached_property
    def within(self) -> np.ndarray:
        """1 where the motors give what is asked of them, 0 at a limit, (steps, joints)."""
        return np.asarray((self.torque == self.asked).astype(float))

    def late(self, course: np.ndarray) -> np.ndarray:
        """What a course (steps, …) changes by if it is late, per second; before its first step it stood still."""
        return np.asarray(-np.diff(course, axis=0, prepend=course[:1]) / self.step_s)

    def at_joints(self, location: str, force: np.ndarray) -> np.ndarray:
        """Forces (steps, joints) at the joints of a location alone, of one parameter: (1, steps, nv)."""
        found = np.zeros((1, *self.qvel.shape))
        at = self.robot.joints_at(location)
        found[0, :, self.robot.joint_dofs[at]] = np.broadcast_to(force, self.velocity.shape).T[at]
        return found

    def at_motors(self, location: str, torque: np.ndarray) -> np.ndarray:
        """The same at the joints that motors drive."""
        return self.at_joints(location, torque * self.robot.driven)


@dataclass(frozen=True)
class Effect(ABC):
    """One unmodelled effect; ``collect`` injects it and ``diagnose`` looks for it, through the same methods.

    At its nominal parameters it changes nothing, bit for bit. A subclass is one file with one frozen dataclass:
    its parameters (declared with ``parameter``), ``name``, and whichever of the methods ``change_…`` it acts through.
    Effects that act together do so in any order. A parameter that stands in place of a value of the model (friction of
    the feet) is ``None`` by default, and a value that equals the model's own changes nothing either.
    """

    location: str = "all"  # Where it acts: all, front, rear, a joint group, a leg, a joint, a foot

    name: ClassVar[str]
    words: ClassVar[str] = ""
    """What it is called in reports, such as ``viscous friction``; empty: the first line of its class's docstring."""
    other_names: ClassVar[tuple[str, ...]] = ()
    """Further names by which it is found; ``called`` says which of them all reports use."""
    by_default: ClassVar[bool] = True
    """Whether a diagnosis looks for it when its settings name no effects; each effect looked for costs time."""
    differs_per_log: ClassVar[bool] = False  # Whether its value may differ from log to log
    needs_base: ClassVar[bool] = False  # Whether it exists only on a robot with a free base
    needs_motor: ClassVar[bool] = False  # Whether it acts on motors alone, and so at no passive joint
    in_controller: ClassVar[bool] = False
    """Whether it acts in the joint PD, which a model of the robot alone does not hold."""
    beside_clock: ClassVar[bool] = False
    """Whether it is looked for in logs that are judged by a clock of their own, though not by default."""
    has_rotors: ClassVar[bool] = False
    """Whether it puts rotors beside joints (``robot.rotors``), whose first states follow from those of the joints."""
    along_joints: ClassVar[bool] = False
    """Whether it acts at each joint of its place as a torque along that joint alone, whatever it does at others."""
    command_stage: ClassVar[CommandStage] = CommandStage.ARRIVAL
    """Where on their way it changes commands. Where rows are uneven, effects act in the order of these stages, since
    commands that are shifted in time no longer tell what each row sent."""
    places: ClassVar[str] = "none"
    """What ``location`` chooses among: ``joints``, ``feet``, or ``none`` (acts on the robot as a whole)."""

    @classmethod
    def called(cls, robot: Robot) -> str:
        """Its name in reports on a robot."""
        return cls.name

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """What a robot lacks for this effect to exist on it, in words; None where it lacks nothing."""
        if (cls.needs_base or cls.places == "feet") and not robot.has_free_base:
            return "a free base"
        if (cls.places == "joints" or cls.needs_motor) and not robot.joints:
            return "joints"
        return "feet" if cls.places == "feet" and not robot.feet else None

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """The parameters at a place of a robot, in the order of their declaration.

        By default what the fields declare. A class whose nominal value or range is the model's own overrides this;
        a field declared with the nominal value ``None`` demands it.
        """
        found = []
        for name, about in cls.declarations().items():
            if about.nominal is None or about.moderate is None:
                raise TypeError(f"{cls.__name__}.parameters has to say what the model's own {name} is")
            ends = (about.lower, about.upper, about.moderate)
            found.append(Parameter(name, about.unit, about.nominal, *ends, logarithmic=about.logarithmic))
        return tuple(found)

    @classmethod
    def declarations(cls) -> dict[str, Declaration]:
        """Declarations of the fields, by name of the parameter."""
        return {f.name: f.metadata[PARAMETER] for f in fields(cls) if PARAMETER in f.metadata}

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name, without those left at the model's own value."""
        of_all = {name: getattr(self, name) for name in self.declarations()}
        return {name: value for name, value in of_all.items() if value is not None}

    @property
    def is_nominal(self) -> bool:
        """Whether every parameter has its default, with which the effect is absent from any robot."""
        return all(getattr(self, name) == about.nominal for name, about in self.declarations().items())

    def is_nominal_for(self, robot: Robot) -> bool:
        """Whether the effect is absent from this robot: every parameter has its default, or the model's own value."""
        return all(self.values.get(p.name, p.nominal) == p.nominal for p in self.parameters(robot, self.location))

    def on_model_ground(self) -> "tuple[Effect, ...]":
        """Effects that do the same to what is reported and leave the ground as the model has it; by default this one.

        Contacts are far from linear in the ground, and no contact changes where ground and robot move together.
        """
        return (self,)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Generalised force that it adds along a motion of the nominal robot, per unit of each parameter at nominal.

        (parameters, steps, nv), N and N·m by the unit of the parameter, in their order. None: it is not known in closed
        form, or no force does the same, and the effect is replayed instead. Zero where the first order vanishes, as for
        a limit that is not met. By default it is known of what acts through ``change_commands`` alone.
        """
        if {method for method in ACTING if overrides(cls, method)} != {"change_commands"}:
            return None
        found = []
        for effect, by in cls.small_departures(at.robot, location):
            changed = effect.change_commands(at.commands, at.step_s, at.robot)
            found.append(at.at_motors("all", at.within * (at.torque_of(changed) - at.sent) / by))
        return np.concatenate(found)

    @classmethod
    def small_departures(cls, robot: Robot, location: str) -> "Iterator[tuple[Effect, float]]":
        """The effect with each of its parameters a little off nominal, and by how much, for derivatives."""
        for one in cls.parameters(robot, location):
            by = SMALL * (one.moderate - one.nominal)
            yield cls(location, **{one.name: one.nominal + by}), by

    def with_profile(self, profile: tuple[float, ...]) -> "Effect":
        """The effect with a value that changes within a log.

        ``profile`` holds factors on the value, evenly spaced from the first row to the last.
        """
        return self

    def extend_to(self, rows: int, all_rows: int) -> "Effect":
        """The effect on a log of ``all_rows`` rows when it was fitted on the first ``rows`` of them."""
        return self

    @property
    def structure(self) -> Hashable | None:
        """Key of the parts that ``change_spec`` adds, whatever their size; None where it adds none.

        Models of equal structure share one batch and are compiled once.
        """
        absent = self.is_nominal or not overrides(type(self), "change_spec")
        return None if absent else (self.name, self.location)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:  # noqa: B027
        """Add the parts that ``structure`` names; ``change_model`` then gives them their size."""

    def change_period(self, period_s: float) -> float:
        """True length of a control period, s, from the nominal one."""
        return period_s

    def change_rows(self, lengths: np.ndarray) -> np.ndarray:
        """True lengths of the rows of a log from nominal ones, in true control periods, (rows,)."""
        return lengths

    def change_step(self, ratio: float) -> float:
        """True length of a step of the simulation over that of the replay, from the nominal ratio."""
        return ratio

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """True motors and joint PD from the nominal ones."""
        return drive

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:  # noqa: B027
        """Put the effect into a model that the caller owns; period and motors are set already."""

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Commands as they reach the joints in periods of ``period_s`` true seconds."""
        return commands

    @property
    def memory_s(self) -> float:
        """How long ago commands and states still count in ``change_commands`` and ``change_measured``, s."""
        return 0.0

    def change_newest_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """The last period of ``change_commands`` alone, which a closed loop asks for at every tick.

        An effect that finds it without the other periods overrides this; both must agree bit for bit.
        """
        return self.change_commands(commands, period_s, robot).newest

    def torque_by_velocity(self, velocity: np.ndarray, robot: Robot) -> np.ndarray | None:
        """Torque that the robot's own controller adds to the commands by measured joint velocities (periods, joints).

        (periods, joints), N·m; None: none.
        """
        return None

    def put_controls(self, control: np.ndarray, load: Load, model: mujoco.MjModel, robot: Robot) -> None:  # noqa: B027
        """Put the controls of actuators that ``change_spec`` has added into all controls, (steps, controls)."""

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """The motion that the log reports when ``motion`` is the true one.

        Rows are ``period_s`` apart unless ``motion.time`` says otherwise.
        """
        return motion

    @property
    def reported_late_s(self) -> float:
        """How late the log reports a part of the state, s: the first true state stands in a later row then."""
        return 0.0

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """True first state from the reported one, the inverse of ``change_measured``.

        The motion has one row. At the start of a piece within a log there is a second one, with what the log reports
        ``start.time[1]`` seconds later, where an effect of the set has ``reported_late_s``.
        """
        return start


@dataclass(frozen=True)
class MotorEffect(Effect):
    """An effect of the motors at some joints."""

    places = "joints"
    along_joints = True
    needs_motor = True


@dataclass(frozen=True)
class DriveEffect(MotorEffect):
    """One number of the motors or of their joint PD: a factor on it, or what is added to it."""

    drive_field: ClassVar[str]  # Name of the field of ``Drive`` that is scaled or added to

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Scale the field by a number that is nominally one, or add to it one that is nominally zero."""
        ((name, about),) = self.declarations().items()
        change = drive.scaled if about.nominal else drive.added
        return change(self.drive_field, robot.joints_at(self.location), getattr(self, name))


@dataclass(frozen=True)
class AddedToJoints(Effect):
    """A number added to the model's own at each joint of a place; negative values reduce it, down to none."""

    places = "joints"
    along_joints = True

    model_field: ClassVar[str]  # Field of MuJoCo's model, a row a degree of freedom; of several columns the first one
    most: ClassVar[float] = 0.0
    """Upper end of the search as a share of the motors' largest torque, where that is more than declared."""

    @classmethod
    def own(cls, model: mujoco.MjModel, robot: Robot, location: str) -> tuple[np.ndarray, np.ndarray]:
        """The field of a model, (dofs,), and the degrees of freedom at a location."""
        values = getattr(model, cls.model_field)
        return values if values.ndim == 1 else values[:, 0], robot.joint_dofs[robot.joints_at(location)]

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From none at all upwards."""
        (declared,) = super().parameters(robot, location)
        values, dofs = cls.own(robot.model, robot, location)
        return (addition(widened(declared, robot, location, cls.most), values[dofs]),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the numbers of the joints; no sum is below zero."""
        if self.is_nominal:
            return
        values, dofs = self.own(model, robot, self.location)
        (by,) = self.values.values()
        values[dofs] = np.maximum(values[dofs] + by, 0.0)
        if self.model_field == "dof_armature":
            recompute_constants(model)


@cache
def overrides(kind: type[Effect], method: str) -> bool:
    """Whether a class of effects overrides a method or a property."""
    return getattr(kind, method) is not getattr(Effect, method)


def overriding(effects: Iterable[Effect], method: str) -> list[Effect]:
    """The effects whose class overrides a method or a property; the others are not called, which saves time."""
    return [effect for effect in effects if overrides(type(effect), method)]


def addition(declarations: Parameter, own: np.ndarray) -> Parameter:
    """A parameter that is added to the model's own values (places,) and may take all of them away.

    The upper limit is at least the model's largest own value, and the moderate value at least a fifth of that.
    """
    most = float(own.max(initial=0.0))
    return replace(
        declarations,
        lower=-most,
        upper=max(declarations.upper, most),
        moderate=max(declarations.moderate, most / 5),
        scale=float(own.mean()) if len(own) else 0.0,
        lower_is_physical=True,
    )


def widened(declarations: Parameter, robot: Robot, location: str, share: float) -> Parameter:
    """A parameter whose upper limit is at least a share of the largest torque of the motors there, N·m.

    Friction, damping and rotor inertia grow with the size of motors and gears.
    """
    most = robot.largest_torque(location)
    return declarations if most is None else replace(declarations, upper=max(declarations.upper, share * most))


def mean_of(own: np.ndarray) -> float:
    """Mean of the model's own values (places,); exactly their value where all are equal."""
    return float(own[0] if (own == own[0]).all() else own.mean())


def recompute_constants(model: mujoco.MjModel) -> None:
    """Recompute constants that MuJoCo derives from masses, armatures and shapes; see ``constants_at_end``."""
    if model is _later.model:
        _later.asked = True
    else:
        mujoco.mj_setConst(model, mujoco.MjData(model))


class _Later(threading.local):
    """The model whose constants are recomputed at the end of a block in this thread, and whether an effect asked."""

    model: mujoco.MjModel | None = None
    asked: bool = False


_later = _Later()


@contextmanager
def constants_at_end(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[None]:
    """Let the effects that act in this block ask for a model's constants, and recompute them once, at its end.

    With many effects that change masses, constants would else take longer than the simulation of a short motion.
    ``data`` is working memory for it.
    """
    _later.model, _later.asked = model, False
    try:
        yield
    finally:
        _later.model = None
    if _later.asked:
        mujoco.mj_resetData(model, data)
        mujoco.mj_setConst(model, data)
