"""Motors behind springs and play, and other effects that add parts to a model, against rotors integrated here."""

import itertools

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.effects import moving_arm as arm
from tests.effects.moving_arm import SENT, replay


def behind_a_gear(stiffness: float, play: float, damping: float, steps: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """The arm with the elbow's rotor integrated here: J θ̈ = τ − spring, its PD at the rotor, the link reported."""
    rotor: dict[str, float] = {}
    inertia, step = 0.02, arm.PERIOD_S / steps

    def loosen(model: mujoco.MjModel) -> None:
        model.actuator_biasprm[2], model.dof_armature[2] = 0, 0
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def turn(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        q, v = data.qpos[2], data.qvel[2]
        if not rotor:
            rotor["q"], rotor["v"] = q, v
        twist = rotor["q"] - q
        beyond = twist - np.clip(twist, -play / 2, play / 2)
        spring = stiffness * beyond + (damping * (rotor["v"] - v) if beyond or not play else 0.0)
        motor = SENT.asked[row, 2] - arm.KP * rotor["q"] - arm.KD * rotor["v"]
        rotor["v"] += step * (motor - spring) / inertia
        rotor["q"] += step * rotor["v"]
        data.ctrl[2], data.qfrc_applied[2] = 0, spring

    return arm.simulate(SENT, loosen, turn, steps)


def since(row: int, motion: tuple[np.ndarray, np.ndarray]) -> Log:
    """The log of a motion of the arm without its first rows."""
    sent = arm.Sent(*(of[row:] for of in (SENT.push, SENT.wanted, SENT.speed)))
    return arm.as_log("since", sent, motion[0][row:], motion[1][row:])


@pytest.mark.parametrize(
    ("name", "values", "stiffness", "play", "damping"),
    [
        ("joint_elasticity", {"compliance_rad_nm": 0.006}, 1 / 0.006, 0.0, 0.05),
        ("joint_play", {"play_rad": 0.05}, 20000.0, 0.05, 10.0),
    ],
)
def test_a_motor_behind_a_gear_moves_as_spongs_model(
    name: str, values: dict, stiffness: float, play: float, damping: float, robot_arm: Robot
) -> None:
    """From the middle of a motion, where only the joints' state is known: so the rotor's is found as well."""
    plain, stiff = (since(150, of) for of in (behind_a_gear(stiffness, play, damping), arm.simulate(SENT, steps=20)))
    found = replay(robot_arm, plain, effects.effect(name, "elbow", **values))
    without = replay(robot_arm, plain)
    error = [np.abs(of - plain.per_joint("joint_pos", arm.JOINTS)).max() for of in (found, without)]
    steps = np.abs(replay(robot_arm, stiff) - stiff.per_joint("joint_pos", arm.JOINTS)).max()
    assert error[1] > 4e-3
    assert error[0] < steps + 0.1 * error[1]


def test_a_spring_and_play_act_at_one_joint_in_any_order(robot_arm: Robot, log: Log) -> None:
    both = [effects.effect("joint_elasticity", "elbow", compliance_rad_nm=0.003)]
    both.append(effects.effect("joint_play", "all", play_rad=0.02))
    one, other = replay(robot_arm, log, *both), replay(robot_arm, log, *both[::-1])
    assert np.abs(one - other).max() < 1e-9
    assert all(np.abs(one - replay(robot_arm, log, alone)).max() > 1e-3 for alone in both)


def test_without_an_inertia_of_the_rotor_there_is_none_behind_a_gear(tmp_path) -> None:
    bare = arm.load(tmp_path, arm.MJCF.replace('damping="0.1" armature="0.02"', 'damping="0.1"'))
    for name in ("joint_elasticity", "joint_play"):
        assert effects.known()[name].lacks(bare) == "the inertia of its rotors (armature)"


def test_play_at_all_joints_is_stable_at_every_size(robot_arm: Robot, log: Log) -> None:
    """Limits that couple several trees of bodies, which MuJoCo's solver does not stand with sparse matrices."""
    for play in (1e-4, 0.01, 0.1):
        for replayer in (Replayer(robot_arm), Replayer(robot_arm, largest_step_s=0.00025)):
            (motion,) = replayer.motions([Rollout(log, (effects.effect("joint_play", play_rad=play),))])
            assert np.abs(np.diff(motion.qpos, axis=0)).max() < 0.05


def test_a_rotor_has_no_friction_of_the_files_defaults(tmp_path, robot_arm: Robot, log: Log) -> None:
    """A file whose default joint has armature, damping and friction, and whose joints say what they have instead."""
    defaults = '<default><joint armature="0.5" damping="3" frictionloss="2" stiffness="9" range="-9 9"/></default>'
    stated = arm.MJCF.replace("<worldbody>", f"{defaults}<worldbody>").replace("<joint ", '<joint stiffness="0" ')
    stated = stated.replace('<joint stiffness="0" armature="0.5"', '<joint armature="0.5"', 1)
    stated = stated.replace('armature="0.02"/>', 'armature="0.02" frictionloss="0" limited="false"/>')
    other = arm.load(tmp_path, stated)
    assert np.array_equal(other.model.dof_armature, robot_arm.model.dof_armature)
    for name in ("joint_elasticity", "joint_play"):
        (about,) = effects.known()[name].parameters(robot_arm)
        found = effects.effect(name, **{about.name: about.moderate})
        assert np.abs(replay(other, log, found) - replay(robot_arm, log, found)).max() < 1e-9


def test_two_effects_that_add_parts_act_together_in_either_order(robot_arm: Robot, log: Log) -> None:
    """Each effect adds what it needs, however many parts another one added before it."""
    hypotheses = list_hypotheses(list(effects.known().values()), robot_arm, None)
    moderate = [h.on(log.name, h.clip(h.moderate)) for h in hypotheses if h.location == "all"]
    adds = [effect for effect in moderate if effect.structure is not None]
    assert {"motor_lag", "velocity_filter", "static_friction", "joint_elasticity"} <= {one.name for one in adds}
    replayer, rows = Replayer(robot_arm), 200
    for one, other in itertools.combinations(adds, 2):
        orders = [Rollout(log, (one, other)), Rollout(log, (other, one))]
        first, second = (motion.qpos for motion in replayer.motions(orders, rows))
        assert np.abs(first - second).max() < 1e-6, (one.name, other.name)
