"""What plans reckon with of a corrected robot."""

import numpy as np
import pytest

from leapgap import effects
from leapgap.errors import InputError
from leapgap.jumping.models.planar import body_with, planar_robot_with
from leapgap.robot.model import Robot

CROUCH = np.array([0, 0.4 * np.pi, -0.75 * np.pi] * 4)


def test_mass_and_inertia_of_the_nominal_robot_are_the_published_ones(robot: Robot) -> None:
    body = body_with(robot, (), CROUCH)
    assert body.mass_kg == pytest.approx(12.453, abs=1e-3)
    assert body.pitch_inertia_kgm2 == pytest.approx(0.347, abs=1e-3)


def test_a_payload_is_part_of_the_rigid_body(robot: Robot) -> None:
    loaded = body_with(robot, (effects.effect("payload", mass_kg=2.0),), CROUCH)
    assert loaded.mass_kg == pytest.approx(14.453, abs=1e-3)
    assert planar_robot_with(robot, (effects.effect("payload", mass_kg=2.0),)).total_mass == pytest.approx(
        14.453, abs=1e-3
    )


def test_what_plans_cannot_express_is_refused_by_name(robot: Robot) -> None:
    weak = effects.effect("joint_damping", "RR_calf", damping=0.4)
    with pytest.raises(InputError, match="joint_damping at RR_calf, motor_lag at all"):
        planar_robot_with(robot, (weak, effects.effect("motor_lag", time_constant_s=0.003)))
