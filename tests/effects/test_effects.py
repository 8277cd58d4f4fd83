import numpy as np
import pytest

from leapgap import effects
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

TABLE = {
    "aerodynamic_drag": (("coefficient", "N·s²/m²", 0, 0.3, 1, 3),),
    "armature": (("inertia", "kg·m²", 0, 0.005, 0.02, 0.05),),
    "com_offset": (("x_m", "m", 0, 0.01, 0.03, 0.06), ("z_m", "m", 0, 0.01, 0.03, 0.06)),
    "command_delay": (("delay_s", "s", 0, 0.002, 0.005, 0.010),),
    "encoder_bias": (("bias_rad", "rad", 0, 0.01, 0.03, 0.08),),
    "foot_compliance": (("time_constant_s", "s", 0.02, 0.03, 0.04, 0.06),),
    "foot_friction": (("mu", "1", 0.8, 0.55, 0.4, 0.3),),
    "ground_height": (("height_m", "m", 0, 0.01, 0.03, 0.06),),
    "ground_slope": (("pitch_rad", "rad", 0, 0.01, 0.03, 0.08),),
    "joint_damping": (("damping", "N·m·s/rad", 0, 0.1, 0.4, 1.0),),
    "joint_friction": (("torque_nm", "N·m", 0, 0.3, 1.0, 2.5),),
    "leg_geometry": tuple((part, "m", 0, 0.003, 0.005, 0.01) for part in ("hip_x_m", "upper_m", "lower_m")),
    "leg_mass": (("scale", "1", 1, 1.1, 1.3, 1.6),),
    "motor_lag": (("time_constant_s", "s", 0, 0.002, 0.005, 0.010),),
    "payload": (("mass_kg", "kg", 0, 0.3, 1, 2.5),),
    "sample_period": (("scale", "1", 1, 1.02, 1.07, 1.15),),
    "state_latency": (("delay_s", "s", 0, 0.005, 0.015, 0.030),),
    "torque_gain": (("scale", "1", 1, 0.95, 0.85, 0.7),),
    "torque_speed_limit": (("voltage_v", "V", 33, 19, 16, 13),),
    "trunk_inertia": (("scale", "1", 1, 1.2, 1.5, 2),),
}
NAMED_ONLY = {
    "computation_delay": (("share", "rows", 0, 0.25, 0.5, 1.5),),
    "contact_damping": (("scale", "1", 1, 1.3, 2, 4),),
    "gravity_compensation": (("share", "1", 0, 0.05, 0.2, 1),),
    "position_gain": (("scale", "1", 1, 1.1, 1.5, 10),),
    "set_point_filter": (("time_constant_s", "s", 0, 0.003, 0.01, 0.1),),
    "set_point_slew": (("rate_rad_s", "rad/s", 100, 10, 2, 0.3),),
    "supply_sag": (("sag", "1", 0, 0.05, 0.2, 0.5),),
    "torque_limit": (("scale", "1", 1, 0.9, 0.5, 0.3),),
    "velocity_gain": (("scale", "1", 1, 1.1, 1.5, 10),),
    "velocity_filter": (("time_constant_s", "s", 0, 0.0005, 0.001, 0.004),),
    "dropped_commands": (("share", "1", 0, 0.2, 0.5, 0.8),),
    "duty_limit": (("droop_s_rad", "s/rad", 0, 0.02, 0.05, 0.2),),
    "frame_tilt": (("roll_rad", "rad", 0, 0.01, 0.03, 0.1), ("pitch_rad", "rad", 0, 0.01, 0.03, 0.1)),
    "friction_compensation": (("torque_nm", "N·m", 0, 0.1, 0.335, 1.5),),
    "gravity_direction": (("roll_rad", "rad", 0, 0.02, 0.05, 0.2), ("pitch_rad", "rad", 0, 0.02, 0.05, 0.2)),
    "joint_elasticity": (("compliance_rad_nm", "rad/(N·m)", 0, 0.0005, 0.002826, 0.01),),
    "joint_play": (("play_rad", "rad", 0, 0.003, 0.01, 0.05),),
    "link_com": (("outward_m", "m", 0, 0.005, 0.02641, 0.04),),
    "link_inertia": (("scale", "1", 1, 1.2, 1.5, 3),),
    "link_payload": (("mass_kg", "kg", 0, 0.1, 0.3039, 1.0), ("moment_kg_m", "kg·m", 0, 0.01, 0.03039, 0.1)),
    "load_friction": (("share", "1", 0, 0.03, 0.1, 0.3),),
    "loop_delay": (("delay_s", "s", 0, 0.001, 0.003, 0.008),),
    "numerics": (("step_ratio", "1", 1, 0.5, 0.25, 0.1),),
    "quadratic_damping": (("coefficient", "N·m·s²/rad²", 0, 0.01, 0.05, 0.3),),
    "static_friction": (("torque_nm", "N·m", 0, 0.3, 1.0, 2.5),),
    "thermal_fade": (("loss_per_s", "1/s", 0, 0.2, 1.0, 5.0),),
    "torque_offset": (("torque_nm", "N·m", 0, 0.3, 1.005, 5.0),),
}
"""The same of effects that are looked for only when they are named."""
"""Parameter, unit, nominal value for the A1, small, moderate and large; as people rely on them from outside."""
EVERY = TABLE | NAMED_ONLY
SIZES = {name: {own[0]: own[4] for own in effect_parameters} for name, effect_parameters in EVERY.items()}
AT_JOINTS = [name for name, kind in effects.known().items() if kind.places == "joints"]


@pytest.fixture(scope="module")
def replay(robot: Robot, reference: Log):
    replayer, jump = Replayer(robot), reference.first_rows(900)

    def run(*found: effects.Effect) -> Motion:
        return replayer.motions([Rollout(jump, found)])[0]

    return run


def test_effects_are_those_of_the_table_with_its_units_and_sizes(robot: Robot) -> None:
    said = {
        name: tuple((p.name, p.unit, p.nominal, p.moderate) for p in kind.parameters(robot))
        for name, kind in effects.by_default().items()
    }
    assert said == {
        name: tuple((own, unit, nominal, moderate) for own, unit, nominal, _, moderate, _ in effect_parameters)
        for name, effect_parameters in TABLE.items()
    }


def test_further_effects_are_looked_for_when_they_are_named(robot: Robot) -> None:
    assert set(effects.known()) - set(effects.by_default()) == set(NAMED_ONLY)
    assert not any(effects.known()[name].by_default for name in NAMED_ONLY)
    for name, of in NAMED_ONLY.items():
        for p, (own, unit, nominal, _, moderate, _) in zip(effects.known()[name].parameters(robot), of, strict=True):
            assert (p.name, p.unit, p.nominal) == (own, unit, nominal)
            assert p.moderate == pytest.approx(moderate, rel=1e-3)


@pytest.mark.parametrize("name", effects.known())
def test_nominal_changes_no_bit_and_any_other_value_does(name: str, replay) -> None:
    """A knob that does nothing would be found absent with confidence."""
    bare, nominal, acting = replay(), replay(effects.effect(name)), replay(effects.effect(name, **SIZES[name]))
    assert effects.effect(name).is_nominal
    assert np.array_equal(bare.qpos, nominal.qpos)
    assert np.abs(bare.qpos - acting.qpos).max() > 1e-3


@pytest.mark.parametrize("name", AT_JOINTS)
def test_an_effect_acts_at_its_location_only(name: str, robot: Robot, reference: Log) -> None:
    replayer = Replayer(robot)
    nominal, acting = (
        Rollout(reference),
        Rollout(reference, (effects.effect(name, location="RR_calf", **SIZES[name]),)),
    )
    bare, model = replayer.model(nominal), replayer.model(acting)
    at = robot.joints.index("RR_calf")
    own = {"dof": robot.joint_dofs[at], "actuator": robot.joint_actuators[at], "body": robot.joint_bodies[at]}
    fields = {
        "dof": ("dof_damping", "dof_dampingpoly", "dof_frictionloss", "dof_armature"),
        "actuator": ("actuator_gainprm", "actuator_biasprm", "actuator_dynprm", "actuator_forcerange"),
        "body": ("body_mass", "body_inertia", "body_ipos", "body_gravcomp"),
    }
    changed = {
        kind: {
            int(row)
            for field in fields[kind]
            for own_values in [getattr(bare, field)]  # an effect may add actuators behind them
            for row in np.argwhere(np.asarray(own_values != getattr(model, field)[: len(own_values)]))[:, 0]
        }
        for kind in own
    }
    acting_controls = replayer._controls(acting, 900)[:, : bare.nu]
    controls = replayer._controls(nominal, 900) != acting_controls
    changed["actuator"] |= set(np.flatnonzero(controls.any(axis=0)).tolist())
    added = model.actuator_trnid[len(bare.actuator_trnid) :, 0]
    changed["dof"] |= set(model.jnt_dofadr[added].tolist())
    coupled = model.wrap_objid[: 2 * model.ntendon : 2]  # the joints that springs and play couple to rotors
    changed["dof"] |= set(model.jnt_dofadr[coupled].tolist())
    assert all(changed[kind] <= {own[kind]} for kind in own)
    assert any(changed.values())


def test_torque_gain_scales_feed_forward_and_feedback_alike(robot: Robot, reference: Log) -> None:
    import mujoco

    forces = []
    for scale in (1.0, 0.5):
        replayer = Replayer(robot)
        model = replayer.model(Rollout(reference, (effects.effect("torque_gain", scale=scale),)))
        data = mujoco.MjData(model)
        data.qpos[robot.joint_qpos] = reference.per_joint("joint_pos")[0] + 0.02
        data.ctrl[robot.joint_actuators] = replayer._controls(Rollout(reference), 2)[0]
        mujoco.mj_forward(model, data)
        forces.append(data.actuator_force.copy())
    assert forces[1] == pytest.approx(0.5 * forces[0])


def test_a_slower_loop_lets_more_time_pass_a_row(robot: Robot, reference: Log) -> None:
    columns = dict(reference.columns) | {"base_pos_z": reference["base_pos_z"] + 2.0}
    air = Log("air", columns, reference.info).first_rows(200)
    slow = effects.effect("sample_period", scale=1.1)
    nominal, slower = Replayer(robot).motions([Rollout(air), Rollout(air, (slow,))])
    assert slower.qvel[-1, 2] / nominal.qvel[-1, 2] == pytest.approx(1.1, abs=0.02)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("joint_dampng", {}, "found joint_dampng; expected one of aerodynamic_drag, armature"),
        ("joint_damping", {"damp": 1.0}, "found parameter damp; expected one of damping"),
        ("torque_gain", {"scale": -1.0}, "found -1; expected 0.3 to 1.5"),
    ],
)
def test_what_is_no_effect_is_refused(name: str, values: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        effects.effect(name, **values)


@pytest.mark.parametrize("name", EVERY)
def test_bounds_hold_the_nominal_value_and_every_size(name: str, robot: Robot) -> None:
    for p, (_, _, nominal, *sizes) in zip(effects.known()[name].parameters(robot), EVERY[name], strict=True):
        assert p.lower <= nominal <= p.upper
        assert all(p.lower < size < p.upper for size in sizes)


def test_effects_act_together_in_any_order(robot: Robot, reference: Log) -> None:
    """Each names a part of the same model: motors, ground, air, clock and measurement."""
    names = (
        *("motor_lag", "torque_speed_limit", "torque_gain", "encoder_bias", "command_delay", "sample_period"),
        *("ground_height", "ground_slope", "aerodynamic_drag", "foot_friction", "state_latency"),
    )
    found = tuple(effects.effect(name, **SIZES[name]) for name in names)
    jump = reference.first_rows(300)
    one, other = Replayer(robot).motions([Rollout(jump, found), Rollout(jump, found[::-1])])
    assert np.abs(one.qpos - other.qpos).max() < 5e-4  # a ground raised, then turned, is 0.1 mm from one turned first


def test_configuration_round_trip() -> None:
    found = (effects.effect("payload", mass_kg=1.0), effects.effect("torque_gain", location="front", scale=0.8))
    assert effects.from_config(effects.to_config(found)) == found
    assert effects.describe(effects.known()["joint_damping"]) == "viscous friction"
