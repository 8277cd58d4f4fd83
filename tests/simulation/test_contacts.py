"""Ground forces of a whole simulated jump: they push, stay in the friction cone, and carry what moves."""

import mujoco
import numpy as np
import pytest

from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course, MotionPlan, prepare
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout


@pytest.fixture(scope="module")
def contacts(robot: Robot, reference: Log) -> dict[str, np.ndarray]:
    """Of every row: deepest foot, forces on it (normal, tangential), their sum in the world, momentum."""
    replayer = Replayer(robot)
    (ready,) = prepare([MotionPlan("made", reference)], replayer, (), Course())
    trial = Rollout(ready.commanded, first_state=ready.start)
    (motion,) = replayer.motions([trial])
    model = replayer.model(trial)
    data = mujoco.MjData(model)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("depth", "force", "ground", "momentum")}
    control = replayer._controls(trial, len(ready.commanded))
    wrench = np.zeros(6)
    for row, (q, v) in enumerate(zip(motion.qpos, motion.qvel, strict=True)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, control[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        ground = np.zeros(3)
        for number, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, number, wrench)
            rows["force"].append(wrench[:3].copy())
            ground += contact.frame.reshape(3, 3).T @ wrench[:3] * np.sign(contact.frame[2])
        rows["depth"].append(np.max([-c.dist for c in data.contact], initial=0.0))
        rows["ground"].append(ground)
        rows["momentum"].append(robot.total_mass * data.subtree_linvel[1].copy())
    return {name: np.array(values) for name, values in rows.items()}


def test_forces_push_and_stay_inside_the_friction_cone(contacts: dict[str, np.ndarray]) -> None:
    normal, tangential = contacts["force"][:, 0], np.hypot(*contacts["force"][:, 1:].T)
    assert normal.min() >= 0
    assert (tangential <= 0.8 * normal * (1 + 1e-6) + 1e-6).all()
    assert tangential.max() > 20  # a jump forward needs some


def test_feet_do_not_sink_beyond_what_the_contacts_compliance_allows(contacts: dict[str, np.ndarray]) -> None:
    assert contacts["depth"][:1150].max() < 0.004  # up to 240 N a pair while they push
    impact_speed, time_constant = 2.5, 0.02  # m/s of the landing, s of the contact: a critically damped stop
    assert contacts["depth"].max() < impact_speed * time_constant


def test_ground_forces_and_gravity_are_all_that_changes_the_momentum(contacts: dict[str, np.ndarray]) -> None:
    gained = contacts["momentum"][780] - contacts["momentum"][0]
    weight = np.array([0.0, 0.0, -9.81 * 12.453])
    given = (contacts["ground"][:780] + weight).sum(axis=0) / 1000
    assert given == pytest.approx(gained, abs=0.02 * np.linalg.norm(gained))
    flight = contacts["ground"][900:1100]
    assert np.abs(flight).max() == 0.0
