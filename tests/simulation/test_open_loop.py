"""Simulated hardware: the named variants and how their logs begin."""

from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course, MotionPlan, run_open_loop
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import SensorNoise
from tests.code import ROOT
from tests.conftest import standing

SILENT = SensorNoise(0, 0, 0, 0, 0, 0)


def variant(name: str) -> tuple[effects.Effect, ...]:
    entries: Any = OmegaConf.to_container(OmegaConf.load(ROOT / "conf/collect/hardware" / f"{name}.yaml"))
    return effects.from_config(entries["effects"])


@pytest.mark.parametrize(
    ("name", "damping", "coulomb", "armature", "delay_s", "foot_s"),
    [
        ("worn", 0.5, 0.5, 0.03, 0.003, 0.02),
        ("sticky", 2.0, 0.2, 0.01, 0.002, 0.02),
        ("soft", 0.5, 0.3, 0.02, 0.004, 0.03),
    ],
)
def test_named_hardware_has_the_absolute_values_that_define_it(
    robot: Robot, name: str, damping: float, coulomb: float, armature: float, delay_s: float, foot_s: float
) -> None:
    found = variant(name)
    model = Replayer(robot).model(Rollout(standing(robot, 5), found))
    assert model.dof_damping[robot.joint_dofs] == pytest.approx(damping)
    assert model.dof_frictionloss[robot.joint_dofs] == pytest.approx(coulomb)
    assert model.dof_armature[robot.joint_dofs] == pytest.approx(armature)
    assert [model.geom_solref[model.geom(foot).id, 0] for foot in robot.feet] == pytest.approx([foot_s] * 4)
    assert model.actuator_gainprm[:, 7] == pytest.approx(21.5)
    (delay,) = (e for e in found if e.name == "command_delay")
    assert delay.values == {"delay_s": delay_s}


def test_a_log_of_hardware_with_wrong_sensors_and_ground_replays_without_a_gap(robot: Robot, reference: Log) -> None:
    """What injects an effect and what undoes it agree: the true effects leave nothing, from the logged first row."""
    found = (
        effects.effect("encoder_bias", bias_rad=0.03),
        effects.effect("state_latency", delay_s=0.015),
        effects.effect("ground_height", location="front", height_m=0.03),
        effects.effect("command_delay", delay_s=0.003),
        effects.effect("torque_speed_limit", voltage_v=16.0),
    )
    (jump,) = run_open_loop([MotionPlan("made", reference)], robot, found, SILENT, Course(), np.random.default_rng(0))
    motion = Replayer(robot).motions([Rollout(jump, found)], rows=1000)[0]
    measured = jump.stack(("base_pos_x", "base_pos_z"))[:1000]
    assert np.abs(motion.qpos[:, [0, 2]] - measured).max() < 1e-3
    assert np.abs(motion.qpos[:, robot.joint_qpos] - jump.per_joint("joint_pos")[:1000]).max() < 1e-3


@pytest.mark.parametrize(
    "found",
    [
        effects.effect("ground_height", height_m=0.06),
        effects.effect("ground_height", location="front", height_m=0.06),
        effects.effect("ground_slope", pitch_rad=-0.08),
    ],
)
def test_hardware_stands_still_on_its_own_ground_before_it_jumps(
    robot: Robot, reference: Log, found: effects.Effect
) -> None:
    (jump,) = run_open_loop(
        [MotionPlan("made", reference)], robot, (found,), SILENT, Course(), np.random.default_rng(0)
    )
    assert abs(jump["base_linvel_z"][0]) < 0.01
    assert abs(jump["base_angvel_y"][0]) < 0.02
    if found.location == "all" and found.name == "ground_height":
        assert jump["base_pos_z"][0] - 0.06 == pytest.approx(reference["base_pos_z"][0], abs=0.005)
    else:
        assert jump.pitch[0] < -0.06
