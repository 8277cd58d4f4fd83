"""Hostile ticks: what broken sensors, clocks and estimators may tell a controller, and what it answers.

The jump's own state is told to the controllers, and some or most of the ticks are harmed: numbers that are none,
infinite, huge or just possible, clocks that stop, jump or run backwards, vectors of other lengths, kinds and units,
base and joints that contradict each other. A prediction model that answers nonsense is among the harms, too.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from leapgap.jumping.control.border import LARGEST
from leapgap.jumping.control.goal_shift_jump import LateStance, ShiftTracker
from leapgap.jumping.control.goal_shift_mpc import CalmMotion, GoalShiftConfig
from leapgap.jumping.control.jump_sequence import JumpSequence, LandingConfig, LandingMpc, SequenceConfig
from leapgap.jumping.control.mpc import DepartingMpc, JumpMpc, MpcConfig
from leapgap.jumping.control.qp import QpConfig
from leapgap.jumping.control.shifted_plan import QUANTITIES, Observation, ObservedJointPd, ShiftedPlan, ShiftGrid
from leapgap.jumping.control.tracking import Excitation, ExcitedController, JointPd, PhaseGains, Reference
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import AffineModel, PredictionModel, RigidBodyModel, Situation
from leapgap.jumping.planning.reference import reference_to
from leapgap.jumping.task import Target
from leapgap.logs.pair_force import FORCE_X, FORCE_Z
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, Controller, StateEstimate
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import estimate, unchanging

MOTOR_NM = 33.5
"""Largest torque of the A1's motors."""
FRICTION, LARGEST_N = 0.6, 350.0
"""Published limits of the MPC's forces on a pair."""
BAD = (np.nan, np.inf, -np.inf, 1e200, -1e200, 1e6, -1e6, 1e3, 0.0)
VECTORS = ("base_position", "base_quaternion", "base_velocity", "base_angular_velocity", "joint_pos", "joint_vel")
SHARES = (0.05, 0.3, 0.8)
"""Shares of the ticks that are harmed, one of them in each jump: few, so that plans are made of what passes the border,
and many, so that nothing else is left."""
RUN_TICKS = 1400
"""Ticks of one controller, a whole jump at 1 kHz."""


@dataclass
class Tally:
    """What many ticks came to."""

    ticks: int = 0
    nonfinite: int = 0
    outside_limits: int = 0
    exceptions: int = 0
    unrecovered: int = 0
    """Controllers that, told the truth again at the end, did not answer like one that had never been lied to."""
    first: str = ""
    """Of what counts above, the first, in words."""

    def note(self, kind: str, says: str) -> None:
        """Count something that must not happen, by its kind, and keep the words of the first."""
        setattr(self, kind, getattr(self, kind) + 1)
        self.first = self.first or f"{kind}: {says}"


def harmed(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """An estimate with one to three harms."""
    for _ in range(int(rng.integers(1, 4))):
        harm = HARMS[int(rng.integers(len(HARMS)))]
        seen = harm(seen, rng)
    return seen


def has_floats(value: object) -> bool:
    """Whether a value is an array with some float in it."""
    return isinstance(value, np.ndarray) and value.dtype == np.float64 and value.size > 0


def size_of(seen: StateEstimate, name: str) -> int:
    """Length of a vector; of one that has lost its form, 3."""
    value = getattr(seen, name)
    return value.size if isinstance(value, np.ndarray) else 3


def bad_entry(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """One entry of one vector is no number, infinite or huge."""
    name = str(rng.choice(VECTORS))
    value = getattr(seen, name)
    if not has_floats(value):
        return seen  # harmed in its form already
    value = value.copy()
    value.flat[int(rng.integers(value.size))] = rng.choice(BAD)
    return replace(seen, **{name: value})


def bad_vector(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """All entries of one vector are bad, or it has noise of any size."""
    name, value = str(rng.choice(VECTORS)), rng.choice(BAD)
    size = size_of(seen, name)
    noise = rng.normal(size=size) * 10.0 ** rng.integers(-3, 4)
    return replace(seen, **{name: np.full(size, value) if rng.random() < 0.5 else noise})


def other_form(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """A vector of another length, type or shape."""
    name = str(rng.choice((*VECTORS, "foot_contact")))
    size = size_of(seen, name)
    forms: list[Any] = [np.zeros(0), np.zeros(2), np.zeros((3, 1)), None, "0", [0.0, 0.0], np.float64(1.0), 1j]
    forms += [[0.0, [1.0]], [None] * size, [10**400] * size, np.full(size, "0"), np.full(size, 1j), np.ones(size, int)]
    forms += [np.zeros(size, np.float32), np.ma.masked_all(size), {"x": 0.0}, float, np.zeros(size, "datetime64[s]")]
    return replace(seen, **{name: forms[int(rng.integers(len(forms)))]})


def bad_time(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """A clock that is no number, stops, jumps or runs backwards."""
    now = seen.time_s if isinstance(seen.time_s, float) else 0.0
    times: list[Any] = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e12, 1e6, now - 0.3, now + 5, None, "now", 10**400, True]
    times += [np.float32(now), np.array(now), np.array([now, now]), complex(now), now + 0.9, 1, [now]]
    return replace(seen, time_s=times[int(rng.integers(len(times)))])


def other_contact(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """Feet that report contact at random."""
    return replace(seen, foot_contact=rng.random(4) < 0.5)


def far_off(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """Finite, possible and wrong: another attitude, another pose of the legs."""
    quaternion = rng.normal(size=4)
    pose = rng.uniform(-2.7, 2.7, 12)
    return replace(seen, base_quaternion=quaternion / np.linalg.norm(quaternion), joint_pos=pose)


def just_possible(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """All entries of one vector have any size that can have been measured, up to the largest."""
    name = str(rng.choice(list(LARGEST)))
    size = size_of(seen, name)
    sign = rng.choice((-1.0, 1.0), size)
    return replace(seen, **{name: sign * LARGEST[name] * 10.0 ** rng.uniform(-6, 0, size)})


def other_units(seen: StateEstimate, rng: np.random.Generator) -> StateEstimate:
    """Degrees for radians, mm for m, quaternions x y z w or of the other sign, joints in another order."""
    changes: list[dict[str, Any]] = []
    for name, factor in (("joint_pos", 57.3), ("joint_vel", 57.3), ("base_position", 1e3), ("base_velocity", -1.0)):
        value = getattr(seen, name)
        if has_floats(value):
            with np.errstate(over="ignore", invalid="ignore"):
                changes += [{name: value * factor}, {name: value[::-1]}]
    quaternion = seen.base_quaternion
    if has_floats(quaternion):
        changes += [{"base_quaternion": np.roll(quaternion, -1)}, {"base_quaternion": -quaternion}]
    return replace(seen, **changes[int(rng.integers(len(changes)))]) if changes else seen


HARMS: tuple[Callable[[StateEstimate, np.random.Generator], StateEstimate], ...] = (
    *(bad_entry, bad_vector, other_form, bad_time, other_contact, far_off, just_possible, other_units),
)


@dataclass(frozen=True)
class WildModel(PredictionModel):
    """A model that learned nonsense: accelerations that grow with the state, for some states beyond all numbers."""

    inner: PredictionModel
    size: float

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """Those of the inner model, changed by the state and feet of each moment."""
        right = self.inner.affine(situation, contact)
        inputs = np.concatenate([situation.state, situation.foot], axis=-1)
        with np.errstate(over="ignore", invalid="ignore"):
            wild = self.size * np.stack([np.sinh(5 * inputs[:, i : i + 3]).prod(axis=1) for i in range(3)], axis=-1)
            return AffineModel(right.bias + wild, right.by_force * (1 + wild[:, :, None]))


def controllers(robot: Robot, reference: Reference, rng: np.random.Generator) -> Iterator[Controller]:
    """New controllers of every kind, again and again."""
    model, gains = RigidBodyModel(A1_BODY), PhaseGains()

    def mpc(backend: str, of: PredictionModel = model) -> JumpMpc:
        return JumpMpc(reference, robot, gains, of, MpcConfig(qp=QpConfig(backend)))

    while True:
        yield JointPd(reference, robot, gains)
        yield ObservedJointPd(reference, robot, gains, Observation())
        yield mpc("daqp")
        yield mpc("osqp")
        yield mpc(str(rng.choice(("daqp", "osqp"))), WildModel(model, 10.0 ** float(rng.uniform(-3, 6))))
        yield DepartingMpc(reference, robot, gains, model, MpcConfig())
        yield ExcitedController(mpc("daqp"), Excitation(40.0), rng)
        yield LandingMpc(robot, reference.joint_pos[0], LandingConfig(), A1_BODY)
        jumps = [JointPd(reference, robot, gains), mpc("daqp")]
        yield shift_tracker(robot, reference, gains)
        yield shift_tracker(robot, reference, gains, late=True)
        yield JumpSequence(jumps, robot, SequenceConfig(settle_s=0.2), A1_BODY)


@dataclass(frozen=True)
class Law:
    """A landing that follows from the shifts and from what the trunk does, of any size."""

    authority: np.ndarray
    authority_error: np.ndarray

    def planned_to(self, goal: np.ndarray) -> "Law":
        """The same for all goals."""
        return self

    def expect(self, goal: np.ndarray, stance: float) -> np.ndarray:
        """Where a jump lands that nothing disturbs: on its goal, x, z and pitch, (3,)."""
        return goal

    @property
    def calm(self) -> CalmMotion:
        """Deviations stay what they are, so narrowly that much counts as sudden."""
        return unchanging(len(self.authority), share=0.01)

    def change(self, update: int, age: int, since: np.ndarray) -> np.ndarray:
        """The trunk's deviation since."""
        return since[:3]


def shift_tracker(robot: Robot, reference: Reference, gains: PhaseGains, late: bool = False) -> ShiftTracker:
    """Goal-shift MPC whose joints and trunk follow the goal by small waves, and whose torques and forces do not.

    ``late``: they follow the stance in the same way, and it is measured in the jump.
    """
    slopes, axes = {}, 4 if late else 3
    for name in QUANTITIES:
        rows, columns = getattr(reference, name).shape
        waves = np.sin(np.outer(np.linspace(0, 9, rows), np.arange(1, axes * columns + 1) / columns))
        size = 0.0 if name in ("torque", "force") else 1.0
        slopes[name] = size * waves.reshape(rows, axes, columns).transpose(1, 0, 2)
    plan, config = ShiftedPlan(reference, slopes), GoalShiftConfig()
    updates = ShiftGrid(reference.schedule, config.period_s, config.steps).updates
    across = np.array([[1.0, 0.2, 0.0], [0.1, 0.8, 0.0], [0.4, 0.3, 0.6]])
    law = Law(np.linspace(2, 0, updates)[:, None, None] / updates * across, np.full((1, updates, 3, 3), 1e-3))
    goal = np.array([0.6, 0.0, 0.0])
    pitches = np.array([-0.2, 0.0, 0.2])
    stance = LateStance(pitches, goal + pitches[:, None] * [-0.5, 0.0, 0.3]) if late else None
    return ShiftTracker(plan, robot, gains, config, goal, 0.0, goal, law, late=stance)


def truth_at(reference: Reference, tick: int) -> StateEstimate:
    """What sensors without error tell."""
    row = min(tick, len(reference.state) - 1)
    seen = estimate(tick / 1000, reference.state[row], reference.joint_pos[row], touching=not 800 <= row < 1150)
    return replace(seen, joint_vel=reference.joint_vel[row])


def check(command: Command, controller: Controller, told: StateEstimate, tally: Tally) -> None:
    """Count what must not be sent."""
    kind, joints, parts = type(controller).__name__, len(controller.robot.joints), vars(command)  # type: ignore[attr-defined]
    shapes = {name: (4,) if name == "planned_force" else (joints,) for name in parts}
    if not all(
        isinstance(part, np.ndarray) and part.shape == shapes[name] and np.isfinite(part).all()
        for name, part in parts.items()
    ):
        tally.note("nonfinite", f"{kind}, told {told}: {command}")
        return
    torque, force = np.abs(command.torque).max(), command.planned_force
    outside = torque > MOTOR_NM + 1e-9 or command.kp.min() < 0 or command.kd.min() < 0
    if not isinstance(controller, ExcitedController):  # whose random forces obey no cone
        cone = np.abs(force[FORCE_X]) - FRICTION * force[FORCE_Z]
        outside |= bool((cone > 0.11).any() or (force[FORCE_Z] > LARGEST_N + 0.11).any())
    if outside:
        tally.note("outside_limits", f"{kind}, told {told}: {command}")


def hostile_ticks(ticks: int, seed: int | tuple[int, ...], robot: Robot, reference: Reference) -> Tally:
    """Run controllers of every kind through that many ticks; a share of them is harmed, those of a jump's end never."""
    rng, tally = np.random.default_rng(seed), Tally()
    for controller in controllers(robot, reference, rng):
        share = float(rng.choice(SHARES))
        for tick in range(RUN_TICKS):
            told = truth_at(reference, tick)
            if rng.random() < share and tick < RUN_TICKS - 100:
                told = harmed(told, rng)
            try:
                check(controller.command(told), controller, told, tally)
            except Exception as error:
                tally.note("exceptions", f"{type(controller).__name__}, told {told}: {type(error).__name__}: {error}")
            tally.ticks += 1
        if not recovered(controller):
            tally.note("unrecovered", type(controller).__name__)
        if tally.ticks >= ticks:
            return tally
    raise AssertionError("controllers never end")


def recovered(controller: Controller) -> bool:
    """Whether the last ticks, which told the truth, were used."""
    return controller.border.newest is not None  # type: ignore[attr-defined]


def a1_and_reference() -> tuple[Robot, Reference]:
    """The robot, and a jump of 60 cm."""
    robot = Robot.load()
    with TemporaryDirectory() as none:
        return robot, Reference.of(reference_to(Target(0.6), Path(none), planar_robot(robot)), robot)


def bad_problems(count: int, seed: int) -> Counter[str]:
    """Statuses of both QP solvers on bad problems; one that raises counts under its exception."""
    from leapgap.jumping.control.qp import BACKENDS, Qp, solver

    rng, found = np.random.default_rng(seed), Counter[str]()
    for number in range(count):
        qp = bad_problem(rng)
        assert isinstance(qp, Qp)
        for backend in BACKENDS:
            try:
                found[f"{backend}: {solver(QpConfig(backend, max_iterations=2000)).solve(qp).fault(0.1, 1e-4)}"] += 1
            except Exception as error:
                found[f"{backend} raised {type(error).__name__} at problem {number}: {error}"] += 1
    return found


def bad_problem(rng: np.random.Generator) -> Any:
    """A quadratic programme with one part that a broken model might have given it."""
    from leapgap.jumping.control.qp import Qp

    n, m = 6, 8
    root = rng.normal(size=(n, n))
    parts = {
        "hessian": root @ root.T + np.eye(n),
        "gradient": rng.normal(size=n),
        "lower": -np.ones(n),
        "upper": np.ones(n),
        "rows": rng.normal(size=(m, n)),
        "row_upper": np.ones(m),
    }
    name = str(rng.choice(list(parts)))
    part = parts[name].copy()
    way = int(rng.integers(6))
    if way == 0:
        part[...] = rng.choice(BAD)
    elif way == 1:
        part.flat[int(rng.integers(part.size))] = rng.choice(BAD)
    elif way == 2:
        part = -part
    elif way == 3:
        part = part * 10.0 ** float(rng.integers(-300, 300))
    elif way == 4:
        part = np.zeros(3)
    else:
        part = part * 0
    return Qp(**(parts | {name: part}))
