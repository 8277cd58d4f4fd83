"""Models that are lent to one roll-out after the other: nothing of an effect stays in them, meshes or none."""

import time
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.hypotheses import Hypothesis, usable
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts
from tests.conftest import standing
from tests.plain_simulation import Pd, by_motors, simulate

ARM = """
<mujoco>
  <compiler meshdir="."/>
  <default><geom type="mesh" mesh="ball"/></default>
  <asset><mesh name="ball" file="ball.obj"/></asset>
  <worldbody>
    <geom name="post" pos="0.28 0 0.32"/>
    <body pos="0 0 0.5">
      <joint name="shoulder" axis="0 1 0" damping="0.1"/>
      <inertial pos="0.15 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <geom pos="0.15 0 0"/>
      <geom pos="0.15 0 0" contype="0" conaffinity="0" group="2"/>
      <body pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1"/>
        <inertial pos="0.15 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
        <geom pos="0.15 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>"""
"""An arm of meshes that collide, and one that only shows; it falls onto a post."""


def numbers(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Every number of a model."""
    found = {name: getattr(model, name) for name in dir(model) if name[0] != "_"}
    found = {name: value for name, value in found.items() if isinstance(value, np.ndarray)}
    for part in (model.opt, model.stat):
        found |= {f"{type(part).__name__}.{n}": np.asarray(getattr(part, n)) for n in dir(part) if n[0] != "_"}
    return {name: value.copy() for name, value in found.items()}


def differing(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> list[str]:
    return [name for name in one if not np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f")]


def moderate(robot: Robot) -> dict[str, tuple[effects.Effect, ...]]:
    kinds = [kind for kind in effects.known().values() if usable(kind, robot)]
    ready = [Hypothesis(kind, robot) for kind in kinds]
    return {h.name: (h.on("log", h.nominal + h.moderate),) for h in ready}


def test_no_effect_leaves_anything_in_a_model(robot: Robot) -> None:
    log = standing(robot, 20)
    changed = 0
    for name, acting in moderate(robot).items():
        replayer, trial = Replayer(robot), Rollout(log, acting)
        with replayer._lent(trial) as lent:
            compiled = numbers(lent.model)
        with replayer.working_model(trial) as working:
            changed += bool(differing(compiled, numbers(working.model)))
            assert working is lent
        working.reset()
        assert differing(compiled, numbers(working.model)) == [], name
    assert changed > 20


def test_pieces_in_company_are_those_alone(robot: Robot) -> None:
    """Of effects, gains and lengths of all kinds, which share models where they can."""
    kp = {f"cmd_kp/{joint}": np.where(np.arange(120) < 50, 300.0, 90.0) for joint in robot.joints}
    logs = [standing(robot, 120, **kp), standing(robot, 120, kp=80.0)]
    state = Replayer(robot).first_state(Rollout(logs[0]))
    starts = Starts([5, 40, 60], np.stack([state] * 3))
    chosen = [(), *moderate(robot).values()][::4]
    trials = [Rollout(log, acting) for acting in chosen for log in logs]
    rows = [20 + 5 * (k % 3) for k in range(len(trials))]
    together = Replayer(robot).replay_pieces(trials, [starts] * len(trials), rows)
    for trial, length, found in zip(trials, rows, together, strict=True):
        for k, piece in enumerate(found):
            ((alone,),) = Replayer(robot).replay_pieces([trial], [starts.chosen([k])], length)
            assert len(piece) == length
            assert np.array_equal(alone.qpos, piece.qpos) and np.array_equal(alone.qvel, piece.qvel)


@pytest.fixture(scope="module")
def mesh_arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    around, up = 200, 100
    a, b = np.meshgrid(np.arange(around) * 2 * np.pi / around, (np.arange(up) + 0.5) * np.pi / up)
    points = 0.08 * np.stack([np.sin(b) * np.cos(a), np.sin(b) * np.sin(a), np.cos(b)], axis=-1).reshape(-1, 3)
    points = np.concatenate([points, [[0, 0, 0.08], [0, 0, -0.08]]])
    at = np.arange(up * around).reshape(up, around)
    near, far = at[:-1].ravel(), at[1:].ravel()
    after, after_far = np.roll(at, -1, axis=1)[:-1].ravel(), np.roll(at, -1, axis=1)[1:].ravel()
    faces = [np.stack(of, axis=1) for of in ((near, far, after), (after, far, after_far))]
    top, bottom = np.full(around, up * around), np.full(around, up * around + 1)
    faces += [np.stack([top, at[0], np.roll(at[0], -1)], axis=1)]
    faces += [np.stack([bottom, np.roll(at[-1], -1), at[-1]], axis=1)]
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in points]
    lines += [f"f {i} {j} {k}" for i, j, k in np.concatenate(faces) + 1]
    (folder / "ball.obj").write_text("\n".join(lines))
    (folder / "arm.xml").write_text(ARM)
    return folder / "arm.xml"


def test_meshes_that_collide_do_so_and_cost_nothing(mesh_arm: Path) -> None:
    plain = simulate(mesh_arm, by_motors, Pd(kp=2.0, kd=0.1, push=0.0), rows=601)
    data = mujoco.MjData(plain.model)
    data.qpos[:] = plain.qpos[-1]
    mujoco.mj_forward(plain.model, data)
    assert data.ncon > 0
    replayer = Replayer(Robot.load(mesh_arm), threads=1)
    damped = Rollout(plain.log, (effects.effect("joint_damping", damping=0.5),))
    moved, _, again = replayer.motions([Rollout(plain.log), damped, Rollout(plain.log)])
    assert np.abs(moved.qpos - plain.qpos).max() < 1e-6
    assert np.array_equal(moved.qpos, again.qpos)
    with replayer.working_model(damped) as working:
        assert mujoco.mj_sizeModel(working.model) > 5e6
        assert working.model.ngeom == plain.model.ngeom  # a box of terrain in place of what only shows
        with pytest.raises(ValueError, match="read-only"):
            working.model.mesh_vert[0] = 0.0
    seconds = []
    for _ in range(20):
        began = time.perf_counter()
        working.reset()
        seconds.append(time.perf_counter() - began)
    assert min(seconds) < 0.001


def test_few_models_are_kept(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    from leapgap.simulation import working_models

    monkeypatch.setattr(working_models, "MOST_KEPT", 3)
    replayer, log = Replayer(robot, threads=1), standing(robot, 20)
    lags = [(effects.effect("motor_lag", location=joint, time_constant_s=0.01),) for joint in robot.joints]
    trials = [Rollout(log, lag) for lag in lags]
    first = [motion.qpos for motion in replayer.motions(trials)]
    assert sum(map(len, replayer.working.spare.values())) <= 3
    assert all(np.array_equal(a, b.qpos) for a, b in zip(first, replayer.motions(trials), strict=True))
