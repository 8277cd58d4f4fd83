"""Files for other simulators: run against the documented names and fields of each, with numbers worked out by hand."""

import ast
import importlib
import inspect
import re
import shutil
import types
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from leapgap import effects
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.report import Cause, ParameterEstimate
from leapgap.effects.base import Effect
from leapgap.export import write_exports
from leapgap.export.base import SIGMAS, CorrectedRobot, Posterior, posterior_of
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import write_corrected
from tests.export import isaac_lab, schemas

CORRECTION = (
    effects.effect("joint_damping", "RR_calf", damping=0.4),
    effects.effect("joint_friction", "RR_calf", torque_nm=0.5),
    effects.effect("command_delay", delay_s=0.004),
    effects.effect("payload", mass_kg=1.0),
    effects.effect("torque_gain", "RR", scale=0.8),
    effects.effect("encoder_bias", "FR_hip", bias_rad=0.02),
)
HALF = {"damping": 0.1, "torque_nm": 0.2, "delay_s": 0.0014, "mass_kg": 0.3, "scale": 0.05, "bias_rad": 0.004}


def cause(effect: Effect) -> Cause:
    estimates = {
        name: ParameterEstimate(value, (value - HALF[name], value + HALF[name]), 0.0, "1", False)
        for name, value in effect.values.items()
    }
    return Cause(effect.name, effect.location, 1.0, estimates, {}, None, 0.0, ())  # type: ignore[arg-type]


def fit(robot: Robot, correlation: float) -> Candidate:
    """A fit of the first two effects, whose numbers are correlated; its own spreads do not matter."""
    hypotheses = tuple(Hypothesis(effects.known()[e.name], robot, e.location) for e in CORRECTION[:2])
    covariance = np.array([[4.0, correlation * 2], [correlation * 2, 1.0]])
    return Candidate(hypotheses, np.array([0.4, 0.5]), covariance, np.zeros((2, 2)))


@pytest.fixture(scope="module")
def posterior(robot: Robot) -> Posterior:
    return posterior_of(robot, CORRECTION, [cause(effect) for effect in CORRECTION], fit(robot, 0.9))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, robot: Robot, posterior: Posterior) -> Path:
    path = tmp_path_factory.mktemp("exports") / "corrected"
    write_corrected(path, robot, CORRECTION)
    written = write_exports(path, CorrectedRobot(posterior, robot, dict.fromkeys(robot.joints, (100.0, 2.0))))
    assert all((path / name).exists() for name in written)
    return path


def test_the_posterior_has_the_intervals_of_the_report_and_the_correlations_of_the_fit(posterior: Posterior) -> None:
    drawn = posterior.samples(4000, np.random.default_rng(1))
    assert drawn.mean(axis=0) == pytest.approx(posterior.mean, rel=1e-2)
    ends = np.percentile(drawn, [2.5, 97.5], axis=0)
    assert (ends[1] - ends[0]) / 2 == pytest.approx(list(HALF.values()), rel=0.02)
    correlation = np.corrcoef(drawn.T)
    assert correlation[0, 1] == pytest.approx(0.9, abs=0.02)
    assert np.abs(correlation[2:] - np.eye(6)[2:]).max() < 0.05
    assert posterior.with_numbers(posterior.mean) == CORRECTION


def test_numbers_stay_within_their_limits(robot: Robot) -> None:
    weak = effects.effect("command_delay", delay_s=0.0002)
    drawn = posterior_of(robot, (weak,), [cause(weak)]).samples(500, np.random.default_rng(0))
    assert drawn.min() == 0.0
    assert (drawn == 0).mean() == pytest.approx(0.4, abs=0.05)  # normal below −0.0002 / (0.0014 / 1.96)


def test_ranges_are_those_of_the_intervals(folder: Path, robot: Robot) -> None:
    found = yaml.safe_load((folder / "randomisation.yaml").read_text())
    own = robot.model.joint("RR_calf")
    damping = found["joints"]["damping"]
    assert set(damping) == {"RR_calf"}
    assert damping["RR_calf"]["value"] == pytest.approx(own.damping[0] + 0.4)
    ends = [damping["RR_calf"][key] - own.damping[0] for key in ("low", "high")]
    assert ends == pytest.approx([0.3, 0.5], rel=1e-4)
    assert found["joints"]["friction"]["RR_calf"]["high"] == pytest.approx(own.frictionloss[0] + 0.7, rel=1e-4)
    mass = found["bodies"]["mass"]["trunk"]
    assert [mass["low"], mass["value"], mass["high"]] == pytest.approx([5.413, 5.713, 6.013], rel=1e-4)
    assert found["correlation"][0][1] == 0.9
    assert found["numbers"]["command_delay at all: delay_s"]["standard_deviation"] == pytest.approx(0.0014 / SIGMAS)


def test_numbers_of_a_robot_keep_no_model_in_memory(robot: Robot, posterior: Posterior) -> None:
    numbers = CorrectedRobot(posterior, robot, {}).numbers(posterior.mean)
    for name, array in numbers.items():
        owner = array
        while isinstance(owner, np.ndarray) and owner.base is not None:
            owner = owner.base
        assert isinstance(owner, np.ndarray), name


def test_every_row_of_the_samples_is_one_robot(folder: Path, robot: Robot) -> None:
    with np.load(folder / "posterior.npz") as file:
        table = {name: file[name] for name in file.files}
    assert table["joints"].tolist() == list(robot.joints)
    calf, trunk = table["joints"].tolist().index("RR_calf"), table["bodies"].tolist().index("trunk")
    numbers = dict(zip(table["numbers_of"].tolist(), table["numbers"].T, strict=True))
    own = robot.model.joint("RR_calf")
    assert table["damping"][:, calf] - own.damping[0] == pytest.approx(numbers["joint_damping at RR_calf: damping"])
    assert table["friction"][:, calf] - own.frictionloss[0] == pytest.approx(
        numbers["joint_friction at RR_calf: torque_nm"]
    )
    mass = robot.model.body("trunk").mass[0]
    assert table["body_mass"][:, trunk] - mass == pytest.approx(numbers["payload at all: mass_kg"])
    assert table["command_delay_s"][:, 0] == pytest.approx(numbers["command_delay at all: delay_s"])


def test_the_same_report_gives_the_same_bytes(folder: Path, robot: Robot, posterior: Posterior, tmp_path: Path) -> None:
    write_corrected(tmp_path / "corrected", robot, CORRECTION)
    write_exports(tmp_path / "corrected", CorrectedRobot(posterior, robot, dict.fromkeys(robot.joints, (100.0, 2.0))))
    for path in folder.rglob("*"):
        if path.is_file():
            assert (tmp_path / "corrected" / path.relative_to(folder)).read_bytes() == path.read_bytes(), path.name


def test_mjlab_gets_actuators_with_lags_and_ranges_by_joint(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = schemas.run(folder / "for_mjlab.py", schemas.mjlab(), monkeypatch)
    by_joint = {one.target_names_expr[0]: one for one in names["actuators"](0.001)}
    calf = by_joint["RR_calf"]
    assert (calf.stiffness, calf.damping) == pytest.approx((80.0, 1.6))
    assert calf.effort_limit == pytest.approx(0.8 * 33.5)
    assert (calf.viscous_damping, calf.frictionloss) == pytest.approx((0.41, 0.7))
    assert (calf.delay_min_lag, calf.delay_max_lag) == (3, 5)  # 2.6 to 5.4 ms
    events = names["EVENTS"]
    for term in events.values():
        schemas.accepts(term)
    assert events["leapgap_damping"].params["ranges"]["RR_calf"] == pytest.approx((0.31, 0.51), rel=1e-4)
    assert events["leapgap_encoder_bias_FR_hip"].params["bias_range"] == pytest.approx((0.016, 0.024), rel=1e-4)
    assert set(events) == {f"leapgap_{key}" for key in ("damping", "friction", "mass", "encoder_bias_FR_hip")}


def test_mjlab_itself_takes_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where mjlab 1.6 is installed: its classes, its functions and an entity with its actuators in ``robot.xml``."""
    entity = pytest.importorskip("mjlab.entity")
    names = schemas.run(folder / "for_mjlab.py", {}, monkeypatch)
    for term in names["EVENTS"].values():
        schemas.accepts(term)
    spec = mujoco.MjSpec.from_file(str(folder / "robot.xml"))
    for motor in list(spec.actuators):
        spec.delete(motor)
    driven = entity.EntityArticulationInfoCfg(actuators=names["actuators"](0.001))
    model = entity.Entity(entity.EntityCfg(spec_fn=lambda: spec, articulation=driven)).compile()
    assert model.nu == 12
    assert model.joint("RR_calf").frictionloss[0] == pytest.approx(0.7)


def test_isaac_lab_gets_delayed_actuators_and_joints_drawn_together(
    folder: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch")
    names = schemas.run(folder / "for_isaac_lab.py", schemas.isaac_lab(), monkeypatch)
    (group,) = names["actuators"](0.002).values()
    assert (group.min_delay, group.max_delay) == (1, 3)
    assert group.stiffness["RR_calf"] == pytest.approx(80.0)
    assert group.friction["RR_calf"] == group.dynamic_friction["RR_calf"] == pytest.approx(0.7)
    assert group.viscous_friction["RR_calf"] == pytest.approx(0.41)
    events = names["EVENTS"]
    for term in events.values():
        schemas.accepts(term)
    assert events["leapgap_mass_trunk"].params["mass_distribution_params"] == pytest.approx((5.413, 6.013), rel=1e-4)

    written: dict[str, Any] = {}

    class Asset:
        device = "cpu"
        joint_names = tuple(reversed(robot.joints))

        def write_joint_friction_coefficient_to_sim(
            self,
            joint_friction_coeff: Any,
            joint_dynamic_friction_coeff: Any = None,
            joint_viscous_friction_coeff: Any = None,
            joint_ids: Any = None,
            env_ids: Any = None,
        ) -> None:
            written.update(dry=joint_friction_coeff, viscous=joint_viscous_friction_coeff, ids=joint_ids, envs=env_ids)

        def write_joint_armature_to_sim(self, armature: Any, joint_ids: Any = None, env_ids: Any = None) -> None:
            written["armature"] = armature

    class Scene(dict[str, Asset]):
        num_envs = 64

    term = events["leapgap_joints"]
    term.func(types.SimpleNamespace(scene=Scene(robot=Asset())), None, **term.params)
    column = [Asset.joint_names[i] for i in written["ids"]].index("RR_calf")
    pairs = torch.stack([written["dry"][:, column], written["viscous"][:, column]]).numpy()
    with np.load(folder / "posterior.npz") as file:
        calf = file["joints"].tolist().index("RR_calf")
        rows = np.stack([file["friction"][:, calf], file["damping"][:, calf]])
    assert np.abs(pairs[:, :, None] - rows[:, None]).sum(axis=0).min(axis=1).max() < 1e-6  # each is one drawn robot
    assert pairs.shape == (2, 64) and np.ptp(pairs[0]) > 0.1


def test_isaac_lab_itself_delays_and_limits_as_the_file_says(
    folder: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where its sources are installed: its own actuator, with a step of the set points and one beyond the limit."""
    torch = pytest.importorskip("torch")
    actuators = isaac_lab.modules(monkeypatch)
    played = {name: of for name, of in schemas.isaac_lab().items() if name != "isaaclab.actuators"}
    names = schemas.run(folder / "for_isaac_lab.py", played, monkeypatch)
    (group,) = names["actuators"](0.002).values()
    assert isinstance(group, actuators.DelayedPDActuatorCfg)
    order, envs = list(reversed(robot.joints)), 64
    motors = group.class_type(cfg=group, joint_names=order, joint_ids=slice(None), num_envs=envs, device="cpu")
    motors.reset(range(envs))
    types_of = importlib.import_module("isaaclab.utils.types")
    zero, torques = torch.zeros(envs, 12), []
    for step in range(8):
        wanted = torch.full((envs, 12), 0.1 if step >= 3 else 0.0)
        action = types_of.ArticulationActions(wanted, zero.clone(), zero.clone())
        torques.append(motors.compute(action, zero, zero).joint_efforts.numpy().copy())
    calf, hip, all_torques = order.index("RR_calf"), order.index("FL_hip"), np.array(torques)
    assert all_torques[-1, 0, [calf, hip]] == pytest.approx([8.0, 10.0])  # 0.1 rad by 80 and 100 N·m/rad
    delays = (all_torques[3:, :, calf] == 0).sum(axis=0)
    assert set(delays.tolist()) == {1, 2, 3}  # of 2 ms each, for 2.6 to 5.4 ms
    action = types_of.ArticulationActions(zero + 5.0, zero.clone(), zero.clone())
    for _ in range(4):
        torque = motors.compute(action, zero, zero).joint_efforts
        action = types_of.ArticulationActions(zero + 5.0, zero.clone(), zero.clone())
    assert torque[0, [calf, hip]].tolist() == pytest.approx([0.8 * 33.5, 33.5], rel=1e-5)
    assert motors.armature[0, calf] == pytest.approx(robot.model.joint("RR_calf").armature[0])
    assert (motors.friction[0, calf], motors.viscous_friction[0, calf]) == pytest.approx((0.7, 0.41))


def test_the_names_of_isaac_lab_are_those_of_its_sources() -> None:
    """Where they are installed: fields and arguments that the other tests play, beside those of version 2.3.2."""
    terms, base = "managers/manager_term_cfg.py", "actuators/actuator_base_cfg.py"
    assert isaac_lab.fields(base, "ActuatorBaseCfg") | {"class_type"} == schemas.ISAAC_BASE
    own = isaac_lab.fields("actuators/actuator_pd_cfg.py", "DelayedPDActuatorCfg")
    assert own - {"class_type"} == {"min_delay", "max_delay"}
    network = isaac_lab.fields("actuators/actuator_net_cfg.py", "ActuatorNetMLPCfg")
    motor = isaac_lab.fields("actuators/actuator_pd_cfg.py", "DCMotorCfg")
    assert schemas.ISAAC_BASE | network | motor == schemas.LEARNED["ActuatorNetMLPCfg"]
    of_term = isaac_lab.fields(terms, "EventTermCfg") | isaac_lab.fields(terms, "ManagerTermBaseCfg")
    assert of_term == schemas.ISAAC_TERM
    mdp = schemas.isaac_lab()["isaaclab.envs"]["mdp"]
    for name in ("randomize_rigid_body_mass", "randomize_rigid_body_com"):
        played = set(inspect.signature(getattr(mdp, name)).parameters)
        assert isaac_lab.arguments("envs/mdp/events.py", name) == played
    articulation = "assets/articulation/articulation.py"
    friction = isaac_lab.methods(articulation, "write_joint_friction_coefficient_to_sim", "Articulation")
    coefficients = {f"joint_{key}friction_coeff" for key in ("", "dynamic_", "viscous_")}
    assert friction == coefficients | {"joint_ids", "env_ids"}
    armature = isaac_lab.methods(articulation, "write_joint_armature_to_sim", "Articulation")
    assert armature == {"armature", "joint_ids", "env_ids"}


def test_pace_gets_its_keys_and_its_vector(folder: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    names = schemas.run(folder / "for_pace.py", schemas.pace(), monkeypatch)
    order = list(reversed(robot.joints))
    motor = names["actuator"](order, 0.002, velocity_limit=21.0)
    assert motor.max_delay == 2
    assert dict(zip(order, motor.encoder_bias, strict=True)) == dict.fromkeys(order, 0.0) | {"FR_hip": 0.02}
    assert motor.saturation_effort == 33.5
    vector = names["parameters"](order, 0.002)
    assert len(vector) == 49
    assert vector[12 + order.index("RR_calf")] == pytest.approx(0.41)
    assert vector[24 + order.index("RR_calf")] == pytest.approx(0.7)
    assert vector[36 + order.index("FR_hip")] == pytest.approx(0.02)
    assert vector[48] == 2


def test_playground_draws_whole_robots(
    folder: Path, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """JAX and the model of MJX are played by NumPy: ``at[…].set``, ``vmap`` and ``tree_replace`` as documented."""

    class Field(np.ndarray):
        @property
        def at(self) -> Any:
            field = self

            class At:
                def __getitem__(self, index: Any) -> Any:
                    def put(values: Any) -> Any:
                        changed = field.copy()
                        changed[index] = values
                        return changed

                    return types.SimpleNamespace(set=put)

            return At()

    class Model(types.SimpleNamespace):
        def tree_replace(self, fields: dict[str, Any]) -> "Model":
            return Model(**(vars(self) | fields))

    def vmap(function: Any) -> Any:
        return lambda keys: tuple(np.stack(of) for of in zip(*map(function, keys), strict=True))

    own = robot.model
    fields = ("dof_damping", "dof_frictionloss", "dof_armature", "body_mass", "body_ipos", "body_inertia", "body_iquat")
    model = Model(**{name: getattr(own, name).copy().view(Field) for name in (*fields, "geom_friction")})
    jax = {
        "vmap": vmap,
        "random": types.SimpleNamespace(randint=lambda key, shape, low, high: int(key) % high),
        "numpy": np,
        "tree_util": types.SimpleNamespace(tree_map=lambda f, of: Model(**{k: f(v) for k, v in vars(of).items()})),
    }
    names = schemas.run(folder / "for_playground.py", {"jax": jax}, monkeypatch)
    changed, axes = names["domain_randomize"](model, np.arange(5), own)
    with np.load(folder / "posterior.npz") as file:
        assert changed.dof_damping[:, 6:] == pytest.approx(file["damping"][:5])
        assert changed.body_mass == pytest.approx(file["body_mass"][:5])
    assert changed.geom_friction.shape == (5, *own.geom_friction.shape)
    assert {name for name, axis in vars(axes).items() if axis == 0} == {*fields, "geom_friction"}
    # A body without a name, which the table calls by its number, keeps the numbers of the model.
    spec, copy = mujoco.MjSpec.from_file(str(robot.path)), shutil.copytree(folder, tmp_path / "copy")
    spec.bodies[3].name = ""
    with np.load(folder / "posterior.npz") as file:
        table = dict(file)
    table["bodies"][3] = "body_3"
    np.savez(copy / "posterior.npz", **table)
    names = schemas.run(copy / "for_playground.py", {"jax": jax}, monkeypatch)
    kept, _ = names["domain_randomize"](model, np.arange(5), spec.compile())
    assert kept.body_mass[:, 3] == pytest.approx(own.body_mass[3])
    assert kept.body_mass[:, 4:] == pytest.approx(changed.body_mass[:, 4:])


def test_mjx_itself_takes_the_robots(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where JAX and MJX are installed."""
    jax, mjx = pytest.importorskip("jax"), pytest.importorskip("mujoco.mjx")
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    draw = schemas.run(folder / "for_playground.py", {}, monkeypatch)["domain_randomize"]
    changed, axes = draw(mjx.put_model(model), jax.random.split(jax.random.PRNGKey(0), 16), model)
    with np.load(folder / "posterior.npz") as file:
        table = file["damping"]
    distance = np.abs(np.asarray(changed.dof_damping)[:, None, 6:] - table[None])
    assert distance.max(axis=2).min(axis=1).max() < 1e-6  # each is one drawn robot
    assert (axes.dof_damping, axes.qpos0) == (0, None)


def test_nothing_of_a_strange_name_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names in models of others are data, also in generated Python."""
    name = 'a"""\\nraise SystemExit("{run}") #\' \\'
    escaped = name.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    (tmp_path / "odd.xml").write_text(f"""<mujoco model="{escaped}"><worldbody><body name="{escaped}">
      <joint name="{escaped}" axis="0 1 0"/><geom size="0.1" mass="1"/></body></worldbody>
      <actuator><motor joint="{escaped}" ctrlrange="-3 3" ctrllimited="true"/></actuator></mujoco>""")
    robot = Robot.load(tmp_path / "odd.xml")
    damped = effects.effect("joint_damping", damping=0.3)
    write_corrected(tmp_path / "corrected", robot, (damped,))
    corrected = CorrectedRobot(posterior_of(robot, (damped,), [cause(damped)]), robot, {robot.joints[0]: (20.0, 1.0)})
    write_exports(tmp_path / "corrected", corrected)
    for path in (tmp_path / "corrected").glob("*.py"):
        ast.parse(path.read_text())
    names = schemas.run(tmp_path / "corrected" / "for_mjlab.py", schemas.mjlab(), monkeypatch)
    (one,) = names["actuators"](0.001)
    assert re.fullmatch(one.target_names_expr[0], robot.joints[0])


def test_a_robot_without_gains_or_ranges_gets_what_can_be_written(tmp_path: Path, robot: Robot) -> None:
    write_corrected(tmp_path, robot, ())
    written = write_exports(tmp_path, CorrectedRobot(posterior_of(robot, (), ()), robot, {}))
    assert "for_mjlab.py" not in written
    assert "no `for_mjlab.py`: no log has the gains of FR_hip" in (tmp_path / "README.md").read_text()
    assert yaml.safe_load((tmp_path / "randomisation.yaml").read_text())["joints"] == {}
