"""An effect class of the user's own is looked for, fitted and reported like ours."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect, parameter
from leapgap.errors import InputError
from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.log import Log
from leapgap.reports.report import html
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import read_corrected, write_corrected
from tests.diagnosis.two_link_arm import SERVO, two_link_arm


@dataclass(frozen=True)
class CableSpring(Effect):
    """Cables that pull a joint back to zero.

    Hoses are not among the effects that we know.
    """

    name = "cable_pull"
    places = "joints"

    stiffness_nm_rad: float = parameter(0.0, "N·m/rad", 0.0, 20.0, 2.0)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        for dof in robot.joint_dofs[robot.joints_at(self.location)]:
            model.jnt_stiffness[model.dof_jntid[dof]] += self.stiffness_nm_rad


STIFFNESS = 4.0


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(two_link_arm(SERVO), encoding="utf-8")
    return Robot.load(path)


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    """Of an arm with a spring in its file."""
    return swung(f' stiffness="{STIFFNESS}"')


def swung(elbow: str) -> list[Log]:
    """By MuJoCo alone: an arm with more in its file, swung by its servos, and noise on what is read."""
    model = mujoco.MjModel.from_xml_string(two_link_arm(SERVO, elbow))
    rng, joints, found = np.random.default_rng(0), ("L_shoulder", "L_elbow"), []
    for i in range(3):
        time = np.arange(800) / 1000
        pulse = 2 * np.pi * (1 + 0.3 * i + 0.4 * np.arange(2))
        wanted, speed = 0.6 * np.sin(np.outer(time, pulse)), 0.6 * pulse * np.cos(np.outer(time, pulse))
        data, states = mujoco.MjData(model), []
        for row in range(len(time)):
            states.append(np.concatenate([data.qpos, data.qvel]))
            data.ctrl[:] = 60 * wanted[row] + speed[row]
            mujoco.mj_step(model, data)
        seen = np.array(states) + rng.standard_normal((len(time), 4)) * [5e-4, 5e-4, 5e-2, 5e-2]
        columns = {"time": time}
        for k, joint in enumerate(joints):
            columns |= {f"joint_pos/{joint}": seen[:, k], f"joint_vel/{joint}": seen[:, 2 + k]}
            columns |= {f"cmd_pos/{joint}": wanted[:, k], f"cmd_vel/{joint}": speed[:, k]}
            columns |= {f"cmd_tau/{joint}": 0 * time, f"cmd_kp/{joint}": 0 * time + 60, f"cmd_kd/{joint}": 0 * time + 1}
        columns = {name: np.ascontiguousarray(values) for name, values in columns.items()}
        found.append(
            Log(f"swing_{i}", columns, jump_info("arm", 0.001, ContactSchedule(), Target(0.0), "made for a test"))
        )
    return found


SETTINGS = Settings(
    effects=["joint_damping", "joint_friction", "torque_gain", "armature"],
    folds=3,
    pieces_per_log=5,
    tolerances={"armature.inertia": 0.0001},
    bootstrap_draws=100,
)


@pytest.mark.parametrize("true", [0.0, 0.15])
def test_a_model_with_too_much_friction_is_told_so(tmp_path: Path, true: float) -> None:
    """The file says 0.5 N·m of the elbow; it truly has none, which is the end of all ranges, or a third."""
    (tmp_path / "stiff.xml").write_text(two_link_arm(SERVO, ' frictionloss="0.5"'), encoding="utf-8")
    logs = swung(f' frictionloss="{true}"')
    report = diagnose(logs, Robot.load(tmp_path / "stiff.xml"), SETTINGS).report
    assert report.verdict == "named" and report.answer == (("joint_friction",),)
    estimate = report.causes[0].parameters["torque_nm"]
    assert estimate.value == pytest.approx(true - 0.5, abs=0.02)
    assert not estimate.at_bound and estimate.ci95[0] >= -0.5
    assert report.closure_of_answer is not None and report.closure_of_answer.value > 0.9


def test_a_users_effect_is_found_fitted_and_reported(arm: Robot, logs: list[Log], tmp_path: Path) -> None:
    found = diagnose(logs, arm, SETTINGS, own=[CableSpring])
    report, cause = found.report, found.report.causes[0]
    assert report.verdict == "named"
    assert (cause.effect, cause.location in ("elbow", "L_elbow")) == ("cable_pull", True)
    assert cause.parameters["stiffness_nm_rad"].value == pytest.approx(STIFFNESS, rel=0.05)
    assert cause.parameters["stiffness_nm_rad"].unit == "N·m/rad"
    assert "cables that pull a joint back to zero (cable_pull at" in report.sentence
    by_name = {log.name: log for log in logs}
    assert "cable_pull" in html(report, logs, arm, by_name, by_name)
    write_corrected(tmp_path / "corrected", arm, found.correction)
    assert read_corrected(tmp_path / "corrected", own=[CableSpring])[1] == found.correction
    with pytest.raises(InputError, match="found cable_pull; expected one of aerodynamic_drag"):
        read_corrected(tmp_path / "corrected")
    without = diagnose(logs, arm, SETTINGS).report
    assert without.answer != (("cable_pull",),) and without.gap_corrected > 1.5 * report.gap_corrected


def test_hypotheses_take_names_and_classes(arm: Robot) -> None:
    found = list_hypotheses(["joint_damping", CableSpring], arm, None)
    assert {h.name for h in found} == {"joint_damping", "cable_pull"}
    own = next(h for h in found if h.name == "cable_pull" and h.location == "L_elbow")
    assert own.on("log", np.array([3.0])) == CableSpring("L_elbow", stiffness_nm_rad=3.0)


@dataclass(frozen=True)
class Wordless(Effect):
    name = "cable_pull"

    pull: float = parameter(0.0, "N", 0.0, 1.0)


@dataclass(frozen=True)
class Nameless(Effect):
    """A complete effect but for the class attribute ``name``."""

    pull: float = parameter(0.0, "N", 0.0, 1.0)


class Undecorated(CableSpring):
    """Has a name and is no dataclass of its own."""

    name = "undecorated"


def test_a_class_is_described_by_its_own_words() -> None:
    assert effects.describe(CableSpring) == "cables that pull a joint back to zero"
    assert effects.describe(Wordless) == "cable pull"
    assert effects.describe(effects.known()["joint_damping"]) == "viscous friction"


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        ([CableSpring, Wordless], "effect class Wordless: found the name cable_pull; expected a name of its own"),
        ([Nameless], "effect class Nameless: found no name; expected a class variable"),
        ([Undecorated], "effect class Undecorated: found no parameter; expected a frozen dataclass"),
        ([CableSpring()], "expected a subclass of leapgap.effects.base.Effect; pass the class itself"),
    ],
)
def test_what_is_no_effect_class_is_refused(kinds: list, message: str) -> None:
    with pytest.raises(InputError, match=message):
        effects.registry(kinds)


def test_a_class_that_does_not_say_what_the_models_own_is_names_the_method(arm: Robot) -> None:
    @dataclass(frozen=True)
    class Stiffness(Effect):
        """In place of the model's own."""

        name = "stiffness"
        stiffness: float | None = parameter(None, "N·m/rad", 0.0, 10.0)

    with pytest.raises(TypeError, match=r"Stiffness\.parameters has to say what the model's own stiffness is"):
        Stiffness.parameters(arm)
    with pytest.raises(InputError, match=r"found None as nominal stiffness; .*; override parameters\(\)"):
        effects.registry([Stiffness])


def test_installed_packages_may_offer_effects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a package's metadata on the path, as pip leaves it."""
    (tmp_path / "their_cables.py").write_text(
        "from dataclasses import dataclass\n"
        "from leapgap.effects.base import Effect, parameter\n"
        "@dataclass(frozen=True)\n"
        "class Theirs(Effect):\n"
        '    """Their cables."""\n'
        '    name = "their_cables"\n'
        '    pull: float = parameter(0.0, "N", 0.0, 1.0)\n'
    )
    metadata = tmp_path / "their_cables-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: their-cables\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[leapgap.effects]\ncables = their_cables:Theirs\n")
    before = list(effects.known())
    monkeypatch.syspath_prepend(str(tmp_path))
    effects.known.cache_clear()
    try:
        assert list(effects.known()) == sorted([*before, "their_cables"])
        assert effects.effect("their_cables", pull=0.5).values == {"pull": 0.5}
        assert effects.describe(effects.known()["their_cables"]) == "their cables"
    finally:
        monkeypatch.undo()
        effects.known.cache_clear()
    assert list(effects.known()) == before
