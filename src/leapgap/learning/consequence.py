"""What the causes of a report do to a policy: the same policy on the robot without them, with each, and with all.

A policy is a network, ONNX or TorchScript, from one vector of observations to one of actions; a map says of what these
consist. It runs on ``Simulator``, whose effects act as in a replay.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.effects.base import Effect, overriding
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.robot.rotations import matrix_of, upright_cosine
from leapgap.simulation.simulator import NOT_STEPPED, Reading, Simulator

Network = Callable[[np.ndarray], np.ndarray]
FALLEN, TILTED = 0.5, 0.5  # a robot has fallen below this share of its first height, or with up at such a cosine
LOST = 1e6  # positions beyond this have left the world of numbers


@dataclass(frozen=True)
class Term:
    """Some entries of an observation, in their order: (value − ``less``) × ``scale``."""

    of: str
    """``joint_pos`` rad, ``joint_vel`` rad/s, ``base_angvel`` rad/s in base axes, ``base_linvel`` m/s in base axes,
    ``gravity`` (unit vector, base axes), ``base_height`` m, ``last_action``, or ``values``, which stand in the map."""
    joints: tuple[str, ...] = ()  # joints in the order of the policy; empty: those of the actions
    values: tuple[float, ...] = ()  # of ``values``: a command, such as the wanted velocity
    less: tuple[float, ...] = ()  # what is taken away: of ``joint_pos`` the pose that is zero for the policy
    scale: float = 1.0


@dataclass(frozen=True)
class PolicyMap:
    """How a policy's numbers belong to a robot: set points are ``offset`` + ``scale`` × action."""

    observation: tuple[Term, ...]
    kp: float  # gains of the joint PD at all joints, N·m/rad and N·m·s/rad
    kd: float
    period_s: float = 0.02
    seconds: float = 10.0
    joints: tuple[str, ...] = ()  # joints of the actions in the order of the policy; empty: that of the model
    scale: float = 1.0
    offset: tuple[float, ...] = ()  # rad, in the order of ``joints``; empty: the pose at the start
    start: tuple[float, ...] = ()  # of the whole robot (nq,) in MuJoCo's order; empty: the first keyframe of its model
    limit: float = 100.0  # actions are cut at ± this

    def __post_init__(self) -> None:
        """Refuse what nothing can be run with."""
        if not self.observation:
            raise InputError("map, observation", "no item", "the terms that a policy observes", "state them")
        if not 0 < self.period_s <= self.seconds < np.inf:
            found = f"{self.seconds:g} s in periods of {self.period_s:g} s"
            raise InputError("map, seconds", found, "one period or more, of a length above 0 s", "correct them")


@dataclass(frozen=True)
class Course:
    """One run of the policy."""

    name: str
    fell_s: float | None  # when a floating robot fell, or the simulation ended in no numbers; None: it did not
    drift_m: float | None  # distance of the base at the end from that without causes; None: a held robot, or a fall
    joints_rad: float  # root mean square departure of the joints from the run without causes, while both last


@dataclass(frozen=True)
class Consequence:
    """What the causes do to a policy."""

    courses: tuple[Course, ...]
    left_out: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON."""
        return asdict(self)

    def __str__(self) -> str:
        """A table for a person."""
        width = max(len(one.name) for one in self.courses)
        lines = [f"{'with':<{width}}  {'falls':>8}  {'base ends off':>13}  {'joints depart':>13}"]
        for one in self.courses:
            falls = "no" if one.fell_s is None else f"{one.fell_s:.2f} s"
            drift = "-" if one.drift_m is None else f"{one.drift_m:.3f} m"
            lines.append(f"{one.name:<{width}}  {falls:>8}  {drift:>13}  {one.joints_rad:>9.4f} rad")
        return "\n".join([*lines, *(f"left out: {one}" for one in self.left_out)])


def read_policy(path: Path) -> Network:
    """The network of a file, by its ending: ``.onnx``, else TorchScript."""
    if not path.is_file():
        raise InputError(path, "no such file", "a policy as ONNX or TorchScript", "name the file")
    try:
        if path.suffix == ".onnx":
            import onnxruntime

            session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
            if len(session.get_inputs()) != 1:
                names = ", ".join(one.name for one in session.get_inputs())
                raise InputError(path, f"the inputs {names}", "one vector of observations", "export it without memory")
            (name,) = (one.name for one in session.get_inputs())
            return lambda seen: np.asarray(session.run(None, {name: seen[None].astype(np.float32)})[0]).ravel()
        import torch

        network = torch.jit.load(str(path), map_location="cpu").eval()
        return lambda seen: np.asarray(network(torch.tensor(seen[None], dtype=torch.float32)).detach().numpy()).ravel()
    except InputError:
        raise
    except Exception as error:  # whatever the two libraries raise for a file that is none of theirs
        says = " ".join(str(error).split())[:200]
        raise InputError(path, f"no policy ({says})", "ONNX or TorchScript", "export it again") from None


@dataclass(frozen=True)
class PolicyRun:
    """A policy with its map on a robot."""

    network: Network
    map: PolicyMap
    robot: Robot

    @property
    def order(self) -> list[int]:
        """Index among the driven joints of each joint of the actions."""
        return self.indices(self.map.joints or self.robot.driven_joints, self.robot.driven_joints, "joints")

    def indices(self, names: Sequence[str], among: Sequence[str], where: str) -> list[int]:
        """Indices of joints; ``InputError`` names one that the robot has not."""
        unknown = [name for name in names if name not in among]
        if unknown:
            raise InputError(f"map, {where}", ", ".join(unknown), f"joints among {', '.join(among)}", "correct it")
        return [list(among).index(name) for name in names]

    def value(self, term: Term, reading: Reading, last: np.ndarray, where: str) -> np.ndarray | Sequence[float]:
        """What a term is of, before its scale."""
        if term.of in ("joint_pos", "joint_vel"):
            names = term.joints or self.map.joints or self.robot.driven_joints
            return np.asarray(getattr(reading, term.of)[self.indices(names, self.robot.joints, where)])
        plain: dict[str, np.ndarray | Sequence[float]] = {"last_action": last, "values": term.values}
        if term.of in plain:
            return plain[term.of]
        known = ("base_angvel", "base_linvel", "gravity", "base_height")
        if term.of not in known or reading.base_quat is None:
            terms = ("joint_pos", "joint_vel", "last_action", "values", *(known if self.robot.has_free_base else ()))
            raise InputError(f"map, {where}", term.of, f"one of {', '.join(terms)}", "correct it")
        assert reading.base_pos is not None
        turn = matrix_of(reading.base_quat)
        if term.of == "base_linvel":
            return np.asarray(turn.T @ np.asarray(reading.base_linvel))
        if term.of == "gravity":
            return np.asarray(-turn[2])
        return reading.base_pos[2:3] if term.of == "base_height" else np.asarray(reading.base_angvel)

    def run(self, effects: Sequence[Effect]) -> tuple[np.ndarray, float | None]:
        """True positions after each period (periods, nq), up to a fall, and its time."""
        simulator = Simulator(self.robot, effects, self.map.period_s)
        nq, order = self.robot.model.nq, self.order
        if self.map.start and len(self.map.start) != nq:
            raise InputError("map, start", f"{len(self.map.start)} numbers", f"{nq} positions", "correct it")
        state = np.concatenate([self.map.start, np.zeros(self.robot.model.nv)]) if self.map.start else None
        reading = simulator.reset(state)
        start = reading.joint_pos[self.robot.driven][order]
        offset = np.array(self.map.offset) if self.map.offset else start
        if len(offset) != len(order):
            raise InputError("map, offset", f"{len(offset)} numbers", f"{len(order)}, one a joint", "correct it")
        last, course = np.zeros(len(order)), list[np.ndarray]()
        height = float(simulator.state[0][2]) if self.robot.has_free_base else 0.0
        target = reading.joint_pos[self.robot.driven].copy()
        for _ in range(round(self.map.seconds / self.map.period_s)):
            # The observation of a reading
            parts = []
            for k, term in enumerate(self.map.observation):
                value = np.asarray(self.value(term, reading, last, f"observation, item {k}"), float)
                if term.less and len(term.less) != len(value):
                    expected = f"{len(value)} numbers"
                    raise InputError(
                        f"map, observation, item {k}, less", f"{len(term.less)} numbers", expected, "correct it"
                    )
                parts.append((value - np.array(term.less or 0.0)) * term.scale)
            action = self.network(np.concatenate(parts))
            if len(action) != len(order) or not np.isfinite(action).all():
                found = f"{len(action)} actions" if len(action) != len(order) else "actions that are no numbers"
                raise InputError("--policy", found, f"{len(order)} finite actions, one a joint", "correct the map")
            last = np.clip(action, -self.map.limit, self.map.limit)
            target[order] = offset + self.map.scale * last
            reading = simulator.step(target, kp=self.map.kp, kd=self.map.kd)
            qpos = simulator.state[0].copy()
            fallen = self.robot.has_free_base and (qpos[2] < FALLEN * height or upright_cosine(qpos[3:7]) < TILTED)
            if not (np.abs(qpos) < LOST).all() or fallen:
                return np.array(course).reshape(-1, self.robot.model.nq), reading.time_s
            course.append(qpos[: self.robot.model.nq])
        return np.array(course), None


def consequence(
    robot: Robot,
    causes: Sequence[Effect],
    network: Network,
    map: PolicyMap,
    progress: Callable[[str], None] = lambda _: None,
) -> Consequence:
    """The policy without causes, with each, and with all of them."""
    left_out, acting = [], []
    for effect in causes:
        why = [says for method, says in NOT_STEPPED.items() if overriding([effect], method)]
        left_out += [f"{effect.name}, which {why[0]}"] if why else []
        acting += [] if why else [effect]
    sets: list[tuple[str, list[Effect]]] = [("none of them", [])]
    sets += [
        (effect.name if effect.location == "all" else f"{effect.name} at {effect.location}", [effect])
        for effect in acting
    ]
    sets += [("all of them", acting)] if len(acting) > 1 else []
    run, courses = PolicyRun(network, map, robot), []
    plain: np.ndarray | None = None
    for step, (name, effects) in enumerate(sets, start=1):
        progress(f"step {step} of {len(sets)}, policy with {name}")
        course, fell = run.run(effects)
        plain = course if plain is None else plain
        rows = min(len(course), len(plain))
        apart = course[:rows] - plain[:rows]
        joints = float(np.sqrt((apart[:, robot.joint_qpos] ** 2).mean())) if rows else 0.0
        ends = robot.has_free_base and fell is None and len(plain) == len(course)
        drift = float(np.linalg.norm(apart[-1, :2])) if ends else None
        courses.append(Course(name, fell, drift, joints))
    return Consequence(tuple(courses), tuple(left_out))
