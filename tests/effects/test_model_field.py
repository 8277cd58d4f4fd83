"""Any number of a model file as an effect, as a setting names it."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.diagnosis.diagnose import chosen_kinds, diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.effects.model_field import ModelField, effect_class
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.settings import from_mapping
from stages.common import read_config
from tests.effects import moving_arm as arm

STIFFNESS = ModelField("jnt_stiffness", 0.0, 20.0, "elbow")


def stiffen(model: mujoco.MjModel) -> None:
    model.joint("elbow").stiffness = 3.0


def damp_cubed(model: mujoco.MjModel) -> None:
    model.dof_dampingpoly[model.joint("shoulder").dofadr[0], 1] = 0.4


def shift(model: mujoco.MjModel) -> None:
    model.body("upper").ipos[0] = 0.2
    model.body_sameframe[:] = 0
    model.geom_sameframe[:] = 0
    mujoco.mj_setConst(model, mujoco.MjData(model))


def thicken_air(model: mujoco.MjModel) -> None:
    model.opt.viscosity = 5.0


def bend_gravity(model: mujoco.MjModel) -> None:
    model.opt.gravity[0] = 2.0


CHANGES: list[tuple[ModelField, float, Callable[[mujoco.MjModel], None]]] = [
    (STIFFNESS, 3.0, stiffen),
    (ModelField("dof_dampingpoly", 0.0, 1.0, "shoulder", entry=1), 0.4, damp_cubed),
    (ModelField("body_ipos", 0.0, 0.3, "upper"), 0.2, shift),
    (ModelField("opt.viscosity", 0.0, 9.0), 5.0, thicken_air),
    (ModelField("opt.gravity", -5.0, 5.0), 2.0, bend_gravity),
]


@pytest.mark.parametrize(("field", "value", "change"), CHANGES)
def test_a_field_moves_the_arm_as_the_changed_model_does(
    field: ModelField, value: float, change: Callable, robot_arm: Robot, log: Log
) -> None:
    kind = effect_class(field)
    plain, nominal = arm.simulate(arm.SENT, change)[0], arm.simulate(arm.SENT)[0]
    assert np.abs(plain - nominal).max() > 1e-3
    assert np.abs(arm.replay(robot_arm, log, kind(value=value)) - plain).max() < 1e-9
    (about,) = kind.parameters(robot_arm)
    assert about.lower <= about.nominal <= about.upper
    for absent in (kind(), kind(value=about.nominal)):
        assert np.array_equal(arm.replay(robot_arm, log, absent), arm.replay(robot_arm, log))


def test_a_spring_that_the_setting_names_is_found(robot_arm: Robot) -> None:
    """Logs by plain MuJoCo of an arm with 3 N·m/rad at the elbow; damping, friction and gain are looked for too."""
    rng, logs = np.random.default_rng(0), []
    for seed in range(3):
        sent = arm.commands(20 + seed, 800)
        qpos, qvel = arm.simulate(sent, stiffen)
        qpos += 2e-4 * rng.standard_normal(qpos.shape)
        qvel += 5e-3 * rng.standard_normal(qvel.shape)
        logs.append(arm.as_log(f"swing_{seed}", sent, qpos, qvel))
    settings = Settings(
        effects=["joint_damping", "joint_friction", "torque_gain"], model_fields=[STIFFNESS], bootstrap_draws=100
    )
    report = diagnose(logs, robot_arm, settings).report
    assert (report.verdict, report.answer) == ("named", (("jnt_stiffness_elbow",),))
    assert report.causes[0].parameters["value"].value == pytest.approx(3.0, rel=0.05)
    assert "another jnt_stiffness of elbow than the model has" in report.sentence


def test_settings_read_fields_from_a_file_and_from_a_stage(robot_arm: Robot) -> None:
    entry = {"field": "jnt_stiffness", "element": "elbow", "lower": 0, "upper": 20}
    of_file = from_mapping(Settings, {"model_fields": [entry]}, "settings.json")
    of_stage = read_config(Settings, OmegaConf.create({"model_fields": [entry]}), "diagnose.settings")
    assert of_file.model_fields == of_stage.model_fields == [STIFFNESS]
    own = [effect_class(field) for field in of_file.model_fields]
    assert [kind.name for kind in chosen_kinds(of_file, own)] == [*effects.by_default(), "jnt_stiffness_elbow"]
    assert "jnt_stiffness_elbow" not in effects.known()
    assert effect_class(STIFFNESS) is own[0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"field": "jnt_stiffness", "element": "knee"}, "Invalid name 'knee'.*expected an element of the model"),
        ({"field": "jnt_stifness", "element": "elbow"}, "found no numbers in jnt_stifness; expected a field of real"),
        ({"field": "jnt_type", "element": "elbow"}, "found no numbers in jnt_type; expected a field of real numbers"),
        ({"field": "body_ipos", "element": "upper", "entry": 3}, "found entry 3; expected an entry of"),
        ({"field": "opt.timestep"}, "found the field opt.timestep; expected a field of mjModel that begins with body_"),
        ({"field": "actuator_gainprm", "element": "elbow"}, "found the field actuator_gainprm; expected a field"),
        ({"field": "body_mass", "element": "upper"}, "found 2 to 9; expected a range that holds the model's own 1.2"),
        ({"field": "body_mass", "element": "upper", "upper": 1}, "found 2 to 1; expected lower below upper"),
    ],
)
def test_what_names_no_number_is_refused(values: dict, message: str, robot_arm: Robot) -> None:
    with pytest.raises(InputError, match=message):
        effect_class(ModelField(**{"lower": 2.0, "upper": 9.0, **values})).parameters(robot_arm)
