"""What effects state in closed form, a force or an error of measurement, against differences of whole roll-outs.

The force of an effect is applied to the joints of plain MuJoCo (``qfrc_applied``), the nominal model under a joint PD
written here; what comes of it is laid beside the motion of the effect itself.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.effects.base import Commands, Effect, ForceContext, overrides
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts
from tests.plain_simulation import BASE, BASE_RATES

STEP_S, ROWS, PIECE, STARTS = 0.001, 400, 100, (5, 70, 150, 220, 299)
KP, KD = 30.0, 1.0
ARM = """<mujoco model="arm"><option timestep="0.001"/>
  <default><geom contype="0" conaffinity="0"/></default><worldbody>
  <body name="turret"><joint name="yaw" axis="0 0 1" damping="0.3" armature="0.02" frictionloss="0.1"/>
    <geom type="cylinder" size="0.05 0.05" mass="1"/>
    <body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.2"/>
      <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" damping="0.1" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.6"/></body></body></body></worldbody>
  <actuator><general joint="yaw" biastype="affine" forcerange="-40 40"/>
    <general joint="shoulder" biastype="affine" forcerange="-40 40"/>
    <general joint="elbow" biastype="affine" forcerange="-40 40"/></actuator></mujoco>"""
SPRINGS = "".join(
    f'<spatial stiffness="150" springlength="0.6"><site site="hook{i}"/><site site="eye{i}"/></spatial>'
    for i in range(3)
)
HOOKS = "".join(
    f'<site name="hook{i}" pos="{x} {y} 4"/>' for i, (x, y) in enumerate(((0.5, 0), (-0.5, 0.4), (-0.4, -0.5)))
)
EYES = HOOKS.replace("hook", "eye").replace(" 4", " 0.05").replace("0.5", "0.2").replace("0.4", "0.1")
FLOATER = (
    ARM.replace("<worldbody>", f'<worldbody>{HOOKS}<body name="trunk" pos="0 0 3"><freejoint/>{EYES}')
    .replace("</worldbody>", '<geom name="box" type="box" size="0.2 0.1 0.05" mass="3"/></body></worldbody>')
    .replace("<actuator>", f"<tendon>{SPRINGS}</tendon><actuator>")
)  # fmt: skip
"""The same arm on a base that hangs on springs."""
WEAK = ARM.replace("-40 40", "-7 7")
"""The same arm with motors that are often at their limits."""


@dataclass(frozen=True)
class Made:
    """A nominal motion by plain MuJoCo, and what moved it."""

    mjcf: str
    push: np.ndarray
    wanted: np.ndarray
    speed: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    qacc: np.ndarray

    @property
    def floats(self) -> bool:
        return self.qvel.shape[1] > 3

    def log(self) -> Log:
        columns = {"time": np.arange(ROWS) * STEP_S}
        if self.floats:
            columns |= dict(zip(BASE, self.qpos[:, :7].T, strict=True))
            columns |= dict(zip(BASE_RATES, self.qvel[:, :6].T, strict=True))
        for i, joint in enumerate(("yaw", "shoulder", "elbow")):
            columns |= {f"joint_pos/{joint}": self.qpos[:, i - 3], f"joint_vel/{joint}": self.qvel[:, i - 3]}
            columns |= {f"cmd_tau/{joint}": self.push[:, i], f"cmd_pos/{joint}": self.wanted[:, i]}
            columns |= {f"cmd_vel/{joint}": self.speed[:, i], f"cmd_kp/{joint}": np.full(ROWS, KP)}
            columns[f"cmd_kd/{joint}"] = np.full(ROWS, KD)
        columns = {name: np.ascontiguousarray(values) for name, values in columns.items()}
        return Log("made", columns, LogInfo("made", STEP_S, "plain MuJoCo"))


def run(
    mjcf: str,
    sent: tuple[np.ndarray, ...],
    first: tuple[np.ndarray, np.ndarray],
    extra: np.ndarray | None = None,
    row: int = 0,
    rows: int = ROWS,
    change: Callable[[mujoco.MjModel], None] = lambda _: None,
    torque: Callable[[np.ndarray, mujoco.MjData, int], np.ndarray] = lambda asked, *_: asked,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations from a state on, under the joint PD and extra forces (steps, nv)."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0, 0
    change(model)
    data, (push, wanted, speed) = mujoco.MjData(model), sent
    data.qpos[:], data.qvel[:] = first
    qpos, qvel, qacc = (np.empty((rows, n)) for n in (model.nq, model.nv, model.nv))
    for k in range(rows):
        qpos[k], qvel[k], at = data.qpos, data.qvel, row + k
        asked = push[at] + KP * (wanted[at] - data.qpos[-3:]) + KD * (speed[at] - data.qvel[-3:])
        data.qfrc_applied[:] = 0 if extra is None else extra[at]
        data.qfrc_applied[-3:] += torque(asked, data, at).clip(*model.actuator_forcerange.T)
        mujoco.mj_step(model, data)
        qacc[k] = (data.qvel - qvel[k]) / STEP_S
    return qpos, qvel, qacc


@cache
def made(mjcf: str) -> Made:
    """Sines at each joint, beyond the limits of the motors at times; the base tumbles."""
    rng, time = np.random.default_rng(5), np.arange(ROWS) * STEP_S
    size, pulse = rng.uniform(0.2, 0.5, (2, 3, 1)), 2 * np.pi * rng.uniform(0.5, 2.5, (2, 3, 1))
    angle = pulse * time + rng.uniform(0, 6, (2, 3, 1))
    wanted, speed = (size * np.sin(angle)).sum(axis=0).T, (size * pulse * np.cos(angle)).sum(axis=0).T
    sent = (16 * np.sin(angle[0].T + 1), wanted, speed)
    model = mujoco.MjModel.from_xml_string(mjcf)
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    qpos[-3:], qvel[-3:] = wanted[0], speed[0]
    if model.nv > 3:
        qvel[:6] = rng.standard_normal(6)
    return Made(mjcf, *sent, *run(mjcf, sent, (qpos, qvel)))


def departure(mjcf: str, at: int, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """How a piece departs from the nominal motion, (rows, 2 nv)."""
    model, of, found = mujoco.MjModel.from_xml_string(mjcf), made(mjcf), []
    for k in range(len(qpos)):
        turn = np.empty(model.nv)
        mujoco.mj_differentiatePos(model, turn, 1.0, of.qpos[at + k], qpos[k])
        found.append(np.concatenate([turn, qvel[k] - of.qvel[at + k]]))
    return np.array(found)


def context(mjcf: str, folder: Path) -> ForceContext:
    (folder / "robot.xml").write_text(mjcf)
    robot, of = Robot.load(folder / "robot.xml"), made(mjcf)
    gains = np.full((ROWS, 3), KP), np.full((ROWS, 3), KD)
    return ForceContext(
        robot, robot.model, of.qpos, of.qvel, of.qacc, Commands(of.push, of.wanted, of.speed), *gains, STEP_S
    )


def measurement(name: str, at: ForceContext, location: str = "all") -> np.ndarray | None:
    """What an effect adds to the reported state, per unit of each parameter at nominal: (parameters, steps, 2 nv)."""
    kind = effects.known()[name]
    if not overrides(kind, "change_measured"):
        return None
    true, nv = Motion(at.qpos, at.qvel), at.qvel.shape[1]
    found = np.zeros((len(kind.declarations()), len(true), 2 * nv))
    for changes, (effect, by) in zip(found, kind.small_departures(at.robot, location), strict=True):
        reported = effect.change_measured(true, at.step_s, at.robot)
        for change, one, other in zip(changes, true.qpos, reported.qpos, strict=True):
            mujoco.mj_differentiatePos(at.model, change[:nv], by, one, other)
        changes[:, nv:] = (reported.qvel - true.qvel) / by
    return found


def by_columns(mjcf: str, force: np.ndarray | None, measured: np.ndarray | None, size: float) -> np.ndarray:
    """Departures of all pieces by an effect's force (steps, nv) and error of measurement (steps, 2 nv)."""
    of, model, found = made(mjcf), mujoco.MjModel.from_xml_string(mjcf), []
    for at in STARTS:
        qpos, qvel = of.qpos[at].copy(), of.qvel[at].copy()
        if measured is not None:
            mujoco.mj_integratePos(model, qpos, -measured[at, : model.nv], size)
            qvel -= size * measured[at, model.nv :]
        extra = None if force is None else size * force
        moved = run(mjcf, (of.push, of.wanted, of.speed), (qpos, qvel), extra, at, PIECE)
        change = departure(mjcf, at, *moved[:2])
        found.append(change if measured is None else change + size * measured[at : at + PIECE])
    return np.array(found)


def by_replays(mjcf: str, robot: Robot, effect: Effect) -> np.ndarray:
    """The same by replays of the effect itself."""
    of = made(mjcf)
    states = np.concatenate([of.qpos, of.qvel], axis=1)

    def course(rows: list[int], later: float) -> np.ndarray:
        at = np.array(rows)
        return np.asarray(later * (states[np.minimum(at + 1, ROWS - 1)] - states[at]))

    starts = Starts(list(STARTS), states[list(STARTS)], course)
    own = Replayer(robot)
    (pieces,), (none,) = (own.replay_pieces([Rollout(of.log(), e)], [starts], PIECE) for e in ((effect,), ()))
    return np.array(
        [
            departure(mjcf, at, a.qpos, a.qvel) - departure(mjcf, at, b.qpos, b.qvel)
            for at, a, b in zip(STARTS, pieces, none, strict=True)
        ]
    )


def alike(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Cosine of two sets of departures, velocities a tenth as heavy as positions, and the ratio of their sizes.

    Without the first row, in which a late velocity has no row before.
    """
    weight = np.where(np.arange(one.shape[2]) < one.shape[2] // 2, 1.0, 0.1)
    a, b = ((weight * of)[:, 1:].ravel() for of in (one, other))
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b)), float(np.linalg.norm(a) / np.linalg.norm(b))


SIZES = {"motor_lag": 1.0, "velocity_filter": 3.0}
"""Departures in moderate ones, where 0.004 of them is less than a step."""
LIMITED = {
    *("duty_limit", "torque_limit", "torque_gain", "torque_offset", "position_gain", "velocity_gain", "command_delay"),
    *("gravity_compensation", "encoder_bias", "supply_sag", "load_friction", "set_point_filter"),
}
"""Effects that limits of the motors matter to."""


def stated(names: set[str], mjcf: str, folder: Path) -> Iterator[tuple[str, ForceContext, type[Effect], int]]:
    """Each parameter of the effects of a robot that state something, with its index."""
    at = context(mjcf, folder)
    for name, kind in effects.known().items():
        if (
            name in names
            and kind.lacks(at.robot) is None
            and (kind.force(at) is None, measurement(name, at) is None) != (True, True)
        ):
            yield from ((name, at, kind, k) for k in range(len(kind.declarations())))


@pytest.mark.parametrize("mjcf", [ARM, FLOATER, WEAK], ids=["held", "floating", "at its limits"])
def test_what_an_effect_states_does_what_the_effect_does(mjcf: str, tmp_path: Path) -> None:
    names, tried = LIMITED if mjcf == WEAK else set(effects.known()) - {"duty_limit", "torque_limit"}, set()
    for name, at, kind, k in stated(names, mjcf, tmp_path):
        about, force, measured = kind.parameters(at.robot)[k], kind.force(at), measurement(name, at)
        by = SIZES.get(name, 0.004) * (about.moderate - about.nominal)
        own = by_columns(mjcf, None if force is None else force[k], None if measured is None else measured[k], by)
        cosine, size = alike(own, by_replays(mjcf, at.robot, kind(**{about.name: about.nominal + by})))
        assert cosine > 0.98 and size == pytest.approx(1, abs=0.25), (name, about.name, cosine, size)
        tried.add(name)
    assert len(tried) > (10 if mjcf == WEAK else 20)


def change(field: str, by: Callable[[np.ndarray], None]) -> Callable[[mujoco.MjModel], None]:
    """A change of one array of the model."""

    def act(model: mujoco.MjModel) -> None:
        by(getattr(model, field))
        model.body_sameframe[:] = 0
        mujoco.mj_setConst(model, mujoco.MjData(model))

    return act


def add(index: object, by: float) -> Callable[[np.ndarray], None]:
    def act(values: np.ndarray) -> None:
        values[index] += by

    return act


def multiply(index: object, by: float) -> Callable[[np.ndarray], None]:
    def act(values: np.ndarray) -> None:
        values[index] *= by

    return act


ELBOW = np.array([0.0, 0.0, 1.0])
IN_MODEL = [
    ("joint_damping", "elbow", 2e-3, change("dof_damping", add(2, 2e-3))),
    ("quadratic_damping", "elbow", 2e-3, change("dof_dampingpoly", add((2, 0), 2e-3))),
    ("joint_friction", "elbow", 2e-3, change("dof_frictionloss", add(2, 2e-3))),
    ("armature", "elbow", 1e-4, change("dof_armature", add(2, 1e-4))),
    ("link_inertia", "shoulder", 0.01, change("body_inertia", multiply(2, 1.01))),
    ("link_com", "elbow", 5e-4, change("body_ipos", add((3, 0), 5e-4))),
    ("gravity_compensation", "elbow", 0.01, change("body_gravcomp", add(3, 0.01))),
]
"""Effect, place, departure, and the changed model; MuJoCo's numbers of the elbow are 2 among the joints."""
WITH_WEIGHTS = ARM.replace("<body ", '<body gravcomp="1e-12" ')


@pytest.mark.parametrize(("name", "location", "by", "changed"), IN_MODEL, ids=lambda of: of if type(of) is str else "")
def test_a_force_does_what_the_changed_model_does(
    name: str, location: str, by: float, changed: Callable[[mujoco.MjModel], None], tmp_path: Path
) -> None:
    at, of = context(WITH_WEIGHTS, tmp_path), made(WITH_WEIGHTS)
    (force,) = effects.known()[name].force(at, location)
    plain = pieces(WITH_WEIGHTS, change=changed)
    cosine, size = alike(by_columns(WITH_WEIGHTS, force, None, by), plain)
    assert cosine > 0.98 and size == pytest.approx(1, abs=0.05)
    assert of.qvel.shape == force.shape


def pieces(mjcf: str, **own: object) -> np.ndarray:
    """Departures of all pieces in a simulation that is changed."""
    of, found = made(mjcf), []
    for at in STARTS:
        moved = run(mjcf, (of.push, of.wanted, of.speed), (of.qpos[at], of.qvel[at]), None, at, PIECE, **own)
        found.append(departure(mjcf, at, *moved[:2]))
    return np.array(found)


AT_MOTORS = [
    ("torque_gain", 0.01, lambda asked, data, row: asked * 1.01),
    ("torque_offset", 0.01, lambda asked, data, row: asked + 0.01),
    ("position_gain", 0.01, lambda asked, data, row: asked + 0.01 * KP * (made(ARM).wanted[row] - data.qpos[-3:])),
    ("velocity_gain", 0.01, lambda asked, data, row: asked + 0.01 * KD * (made(ARM).speed[row] - data.qvel[-3:])),
    ("load_friction", 0.01, lambda asked, data, row: asked - 0.01 * np.abs(asked) * np.tanh(data.qvel[-3:] / 0.05)),
    ("friction_compensation", 0.01, lambda asked, data, row: asked + 0.01 * np.tanh(data.qvel[-3:] / 0.02)),
    ("supply_sag", 0.01, lambda asked, data, row: asked * (1 - 0.01 * np.abs(asked).sum() / 120)),
    (
        "command_delay",
        STEP_S,
        lambda asked, data, row: (
            made(ARM).push[row - 1]
            + KP * (made(ARM).wanted[row - 1] - data.qpos[-3:])
            + KD * (made(ARM).speed[row - 1] - data.qvel[-3:])
        ),
    ),
]
"""Effect, departure, and the torque that a drive gives instead of what is asked of it."""


@pytest.mark.parametrize(("name", "by", "torque"), AT_MOTORS, ids=lambda of: of if type(of) is str else "")
def test_a_force_does_what_another_drive_does(name: str, by: float, torque: Callable, tmp_path: Path) -> None:
    (force,) = effects.known()[name].force(context(ARM, tmp_path))
    cosine, size = alike(by_columns(ARM, force, None, by), pieces(ARM, torque=torque))
    assert cosine > 0.98 and size == pytest.approx(1, abs=0.05)


def test_what_is_measured_wrongly_is_stated_exactly(tmp_path: Path) -> None:
    """A zero that is off shifts a position by as much; a base that is reported late is where it was."""
    at = context(FLOATER, tmp_path)
    (bias,) = measurement("encoder_bias", at, "elbow")
    assert bias == pytest.approx(np.tile(np.eye(18)[8], (ROWS, 1)), abs=1e-9)
    (late,) = measurement("state_latency", at)
    assert late[1:, :6] == pytest.approx(-at.qvel[1:, :6], abs=2e-3)
    assert late[1:, 9:15] == pytest.approx(-at.qacc[:-1, :6], abs=1e-6)
    assert not late[:, 6:9].any() and not late[:, 15:].any()
    assert measurement("payload", at) is None


def test_effects_that_no_force_stands_for_say_so(tmp_path: Path) -> None:
    at = context(ARM, tmp_path)
    for name in ("numerics", "sample_period", "joint_play", "static_friction", "thermal_fade", "set_point_slew"):
        assert effects.known()[name].force(at) is None and measurement(name, at) is None
