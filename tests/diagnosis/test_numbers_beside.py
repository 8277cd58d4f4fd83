"""Tolerances of a model beside the numbers in question: logs of plain MuJoCo of an arm whose masses are off."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.full_rollouts import FullRolloutFit
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.numbers_beside import tolerance_effects
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import joint_fit_in_parts
from tests.diagnosis.two_link_arm import torque_driven_arm

ROTOR, HEAVIER = 0.02, 1.03


def rotors_on_heavy_links(model: mujoco.MjModel) -> None:
    model.dof_armature[:] += ROTOR
    model.body_mass[1:] *= HEAVIER
    model.body_inertia[1:] *= HEAVIER


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def without(robot: Robot) -> JointFit:
    """The joint fit of a model whose masses are taken as they are."""
    return joint_fit_in_parts(robot, rotors_on_heavy_links)


def rotors(robot: Robot, joint: JointFit) -> FullRolloutFit:
    """Rotors fitted alone."""
    (rotor,) = (h for h in list_hypotheses(["armature"], robot, None) if h.location == "all")
    return joint.fit((rotor,), rotor.nominal, 6, settled=0.1)


def test_masses_that_are_off_within_tolerance_move_no_rotor(robot: Robot, without: JointFit) -> None:
    """Taken as they are, they move the rotors by a fifth and by many times the interval."""
    off = rotors(robot, without)
    assert off.numbers[0] - ROTOR > 0.15 * ROTOR
    assert off.numbers[0] - ROTOR > 10 * np.sqrt(off.covariance[0, 0])
    within = rotors(robot, replace(without, near=off, tolerances={"leg_mass.scale": HEAVIER - 1}))
    assert within.numbers[0] == pytest.approx(ROTOR, rel=0.03)
    assert within.covariance[0, 0] > 4 * off.covariance[0, 0]


def test_each_place_has_a_tolerance_of_its_own(robot: Robot) -> None:
    tolerances = {"leg_mass.scale": 0.03, "joint_damping.damping": 0.1}
    effects = tolerance_effects(robot, tolerances, [("joint_damping", "all")])
    assert [(one.name, one.location) for one in effects] == [
        (name, joint) for name in ("leg_mass", "joint_damping") for joint in robot.joints
    ]
    assert all(one.values["scale"] == pytest.approx(HEAVIER) for one in effects if one.name == "leg_mass")


def test_what_acts_alone_at_one_place_has_no_tolerance_there(robot: Robot) -> None:
    """Its own number says what that place is off by; with both, neither is told."""
    tolerances = {"leg_mass.scale": 0.03, "joint_damping.damping": 0.1}
    acting = [("joint_damping", robot.joints[0])]
    assert len(tolerance_effects(robot, tolerances, acting)) == 2 * len(robot.joints)
    effects = tolerance_effects(robot, tolerances, acting, alone=True)
    assert [one.location for one in effects if one.name == "joint_damping"] == list(robot.joints[1:])
    assert [one.location for one in effects if one.name == "leg_mass"] == list(robot.joints)


def test_on_a_robot_that_walks_what_acts_has_no_tolerance_besides() -> None:
    a1, tolerances = Robot.load(), {"foot_friction.mu": 0.02, "armature.inertia": 0.05}
    assert {one.name for one in tolerance_effects(a1, tolerances, [("armature", "all")])} == {"foot_friction"}
    assert {one.name for one in tolerance_effects(a1, tolerances, [])} == {"foot_friction", "armature"}
