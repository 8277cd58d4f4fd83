import numpy as np
import pytest

from leapgap import effects
from leapgap.errors import InputError
from leapgap.recording.jump import Jump
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Motion, Replayer, Trial

SIZES = {
    "armature": {"inertia": 0.02},
    "joint_damping": {"damping": 0.4},
    "joint_friction": {"torque_nm": 1.0},
    "payload": {"mass_kg": 1.0},
    "sample_period": {"scale": 1.07},
    "torque_gain": {"scale": 0.85},
}
AT_JOINTS = [name for name, kind in effects.known().items() if kind.places == "joints"]


@pytest.fixture(scope="module")
def replay(robot: Robot, reference: Jump):
    replayer, jump = Replayer(robot), reference.first_rows(900)

    def of(*found: effects.Effect) -> Motion:
        return replayer.motions([Trial(jump, found)])[0]

    return of


def test_every_effect_has_a_size_here() -> None:
    assert set(SIZES) == set(effects.known())


@pytest.mark.parametrize("name", effects.known())
def test_nominal_changes_no_bit_and_any_other_value_does(name: str, replay) -> None:
    """A knob that does nothing would be found absent with confidence."""
    bare, nominal, acting = replay(), replay(effects.effect(name)), replay(effects.effect(name, **SIZES[name]))
    assert effects.effect(name).is_nominal
    assert np.array_equal(bare.qpos, nominal.qpos)
    assert np.abs(bare.qpos - acting.qpos).max() > 1e-3


@pytest.mark.parametrize("name", AT_JOINTS)
def test_an_effect_acts_at_its_location_only(name: str, robot: Robot, reference: Jump) -> None:
    replayer = Replayer(robot)
    bare = replayer.model(Trial(reference))
    model = replayer.model(Trial(reference, (effects.effect(name, location="RR_calf", **SIZES[name]),)))
    at = robot.joints.index("RR_calf")
    dof, actuator = robot.joint_dofs[at], robot.joint_actuators[at]
    changed_dofs = {
        *np.flatnonzero(bare.dof_damping != model.dof_damping),
        *np.flatnonzero(bare.dof_frictionloss != model.dof_frictionloss),
        *np.flatnonzero(bare.dof_armature != model.dof_armature),
    }
    changed_actuators = set(np.flatnonzero((bare.actuator_gainprm != model.actuator_gainprm).any(axis=1)))
    assert changed_dofs <= {dof}
    assert changed_actuators <= {actuator}
    assert changed_dofs or changed_actuators


def test_torque_gain_scales_feed_forward_and_feedback_alike(robot: Robot, reference: Jump) -> None:
    import mujoco

    forces = []
    for scale in (1.0, 0.5):
        replayer = Replayer(robot)
        model = replayer.model(Trial(reference, (effects.effect("torque_gain", scale=scale),)))
        data = mujoco.MjData(model)
        data.qpos[robot.joint_qpos] = reference.per_joint("joint_pos")[0] + 0.02
        data.ctrl[robot.joint_actuators] = replayer._controls(Trial(reference), 2)[0]
        mujoco.mj_forward(model, data)
        forces.append(data.actuator_force.copy())
    assert forces[1] == pytest.approx(0.5 * forces[0])


def test_a_slower_loop_lets_more_time_pass_a_row(robot: Robot, reference: Jump) -> None:
    columns = dict(reference.columns) | {"base_pos_z": reference["base_pos_z"] + 2.0}
    air = Jump("air", columns, reference.info).first_rows(200)
    slow = effects.effect("sample_period", scale=1.1)
    nominal, slower = Replayer(robot).motions([Trial(air), Trial(air, (slow,))])
    assert slower.qvel[-1, 2] / nominal.qvel[-1, 2] == pytest.approx(1.1, abs=0.02)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("joint_dampng", {}, "found joint_dampng; expected one of armature"),
        ("joint_damping", {"damp": 1.0}, "found parameter damp; expected one of damping"),
        ("torque_gain", {"scale": -1.0}, "found -1; expected 0.3 to 1.5"),
    ],
)
def test_what_is_no_effect_is_refused(name: str, values: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        effects.effect(name, **values)


def test_configuration_round_trip() -> None:
    found = (effects.effect("payload", mass_kg=1.0), effects.effect("torque_gain", location="front", scale=0.8))
    assert effects.from_config(effects.to_config(found)) == found
    assert effects.describe("joint_damping") == "viscous friction of the gears"
