"""Causes of one robot that act together at different joints; plain MuJoCo's logs."""

from pathlib import Path

import mujoco
import pytest

from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import noisy_logs
from tests.diagnosis.test_best_simulator import KINDS, worn
from tests.diagnosis.two_link_arm import torque_driven_arm

pytestmark = pytest.mark.long

HIDDEN = {
    ("joint_damping", "all"): 0.2,
    ("joint_friction", "L_shoulder"): 0.1,
    ("joint_friction", "L_elbow"): 0.25,
    ("armature", "L_shoulder"): 0.01,
    ("armature", "L_elbow"): 0.03,
    ("link_mass", "L_elbow"): 1.15,
}
"""What ``worn`` hides, an effect that is the same at both joints once."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def found(robot: Robot) -> Diagnosis:
    settings = Settings(effects=KINDS, noise_draws=1, bootstrap_draws=100, best=False)
    return diagnose(noisy_logs(robot.path, worn), robot, settings, threads=2)


def test_causes_at_each_joint_are_named_with_their_numbers(found: Diagnosis) -> None:
    report = found.report
    values = {
        (cause.effect, cause.location): next(iter(cause.parameters.values())).value
        for cause in report.causes[: len(report.answer)]
    }
    assert set(values) == set(HIDDEN)
    for which, true in HIDDEN.items():
        assert values[which] == pytest.approx(true, rel=0.1), which
    assert report.verdict in ("named", "ambiguous")
    assert report.closure_of_answer is not None and report.closure_of_answer.value > 0.95


def test_a_tool_at_a_link_is_named_beside_friction_elsewhere(robot: Robot, tmp_path: Path) -> None:
    """By default, with every effect: heavier links, their inertia and gains of motors together do nearly the same."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    tool = {"size": [0.005, 0, 0], "pos": [0.25, 0, 0], "mass": 0.3, "contype": 0, "conaffinity": 0}
    spec.body("lower").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, **tool)
    spec.joint("L_shoulder").frictionloss = 0.3
    spec.compile()
    (tmp_path / "with_tool.xml").write_text(spec.to_xml())
    logs = noisy_logs(tmp_path / "with_tool.xml", lambda model: None)
    report = diagnose(logs, robot, Settings(noise_draws=1, bootstrap_draws=100, best=False), threads=2).report
    assert report.verdict == "named"
    found = {(cause.effect, cause.location): cause.parameters for cause in report.causes[: len(report.answer)]}
    assert set(found) == {("link_payload", "L_elbow"), ("joint_friction", "L_shoulder")}
    payload, beyond_com_m = found["link_payload", "L_elbow"], 0.125
    assert payload["mass_kg"].value == pytest.approx(0.3, rel=0.05)
    assert payload["moment_kg_m"].value == pytest.approx(0.3 * beyond_com_m, rel=0.05)
    assert found["joint_friction", "L_shoulder"]["torque_nm"].value == pytest.approx(0.3, rel=0.05)
