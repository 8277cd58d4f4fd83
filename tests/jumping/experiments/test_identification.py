"""What identification compares of a motion."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.effects import effect
from leapgap.jumping.experiments.identification import CONTACT_PARAMETERS, difference, identify_effects
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course, MotionPlan, run_open_loop
from leapgap.simulation.sensors import SensorNoise
from tests.conftest import standing


@pytest.mark.parametrize(("rate_hz", "instants"), [(1000, 50), (500, 50), (200, 50)])
def test_motions_are_compared_every_20_ms_at_any_rate(robot: Robot, rate_hz: int, instants: int) -> None:
    still = standing(robot, rate_hz)
    columns = dict(still.columns) | {"time": np.arange(rate_hz) / rate_hz}
    log = replace(still, columns=columns, info=replace(still.info, sample_period_s=1 / rate_hz))
    qpos = np.tile(robot.model.qpos0, (rate_hz, 1))
    assert len(difference(qpos, log, robot)) == (3 + len(robot.joints)) * instants


@pytest.mark.long
@pytest.mark.parametrize("softness_s", [0.02, 0.03])
def test_the_softness_of_the_feet_is_told_from_the_joints(robot: Robot, reference: Log, softness_s: float) -> None:
    true = {"joint_damping": 0.6, "armature": 0.01, "foot_compliance": softness_s}
    acting = (
        effect("joint_damping", damping=true["joint_damping"]),
        effect("armature", inertia=true["armature"]),
        effect("foot_compliance", time_constant_s=softness_s),
    )
    plans = [MotionPlan(f"jump_{i}", reference, block_m) for i, block_m in enumerate((0.0, 0.03))]
    logs = run_open_loop(plans, robot, acting, SensorNoise(), Course(), np.random.default_rng(1))
    found = {one.name: next(iter(one.values.values())) for one in identify_effects(logs, robot, (), CONTACT_PARAMETERS)}
    assert found["foot_compliance"] == pytest.approx(true["foot_compliance"], abs=0.003)
    assert found["joint_damping"] == pytest.approx(true["joint_damping"], abs=0.08)
