"""``robot=<name>`` chooses the robot of each stage: plans, masses and diagnosis follow it, or it is refused."""

import json
import subprocess
from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest

from leapgap.errors import InputError
from leapgap.jumping.experiments.rig import PlanSource, Rig
from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.planning.reference import name_of, reference_to, select_planar_robot
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.logs.log import Log, read_log, write_log
from leapgap.robot.model import Robot
from tests import commands
from tests.conftest import standing
from tests.plain_arm import write_model
from tests.robot.quadrupeds import GO2, mjcf

pytest.importorskip("mujoco_menagerie", reason="no mujoco-menagerie: pip install -e '.[menagerie]'")
TARGET = Target(0.4)
GO2_KG = 6.921 + 4 * (0.678 + 1.152 + 0.241352)


@pytest.fixture(scope="module")
def menagerie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder laid out as MuJoCo Menagerie, with the Go2 by its figures and without its meshes."""
    folder = tmp_path_factory.mktemp("checkout")
    (folder / "unitree_go2").mkdir()
    (folder / "unitree_go2" / "scene.xml").write_text(mjcf(GO2))
    return folder


def stage(menagerie: Path, name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return commands.stage(name, "executor=local", *arguments, MENAGERIE_ROOT=str(menagerie))


@pytest.fixture(scope="module")
def plan(menagerie: Path, tmp_path_factory: pytest.TempPathFactory) -> Log:
    out = tmp_path_factory.mktemp("plans") / "out"
    done = stage(menagerie, "optimize", "robot=go2", "optimize.targets=[[0.4,0.0]]", f"optimize.out={out}")
    assert done.returncode == 0, done.stderr
    assert [entry["status"] for entry in json.loads((out / "references.json").read_text())] == ["Solve_Succeeded"]
    return read_log(out / f"{name_of(TARGET)}.parquet")


def test_a_planned_jump_carries_the_mass_of_the_chosen_robot(plan: Log, menagerie: Path) -> None:
    """The force's impulse from rest to take-off is m (g T + v), with v of the centre of mass by MuJoCo."""
    assert plan.info.robot == "go2"
    assert "joint_pos/FR_hip_joint" in plan.columns
    assert centre_height(menagerie, plan, 0) > 0.1  # else the legs do not hold it up
    speed = (centre_height(menagerie, plan, 810) - centre_height(menagerie, plan, 800)) / 0.01 + 9.81 * 0.005
    impulse = 0.001 * float((plan["mpc_force/front_z"] + plan["mpc_force/rear_z"])[:800].sum())
    assert speed > 0.5
    assert impulse / (9.81 * 0.8 + speed) == pytest.approx(GO2_KG, rel=0.02)


def centre_height(menagerie: Path, plan: Log, row: int) -> float:
    """Height of the centre of mass in a row of a plan, m, by the model file."""
    model = mujoco.MjModel.from_xml_path(str(menagerie / "unitree_go2" / "scene.xml"))
    data = mujoco.MjData(model)
    parts = ("pos_x", "pos_y", "pos_z", "quat_w", "quat_x", "quat_y", "quat_z")
    joints = [model.joint(j).name for j in range(1, model.njnt)]
    data.qpos[:7] = [plan[f"base_{part}"][row] for part in parts]
    data.qpos[7:] = [plan[f"joint_pos/{joint}"][row] for joint in joints]
    mujoco.mj_forward(model, data)
    return float(data.subtree_com[0, 2])


def test_jumps_of_another_robot_are_not_taken_from_the_folder(tmp_path: Path, menagerie: Path, robot: Robot) -> None:
    """Plans of the A1 lie where the stage looks; the Go2, 3 kg heavier and with other joints, jumps by its own."""
    write_log(reference_to(TARGET, tmp_path, planar_robot(robot)), tmp_path / "a1" / f"{name_of(TARGET)}.parquet")
    arguments = ("robot=go2", "collect.targets=[[0.4,0.0]]", "collect.jumps=1", "collect.hardware=ideal")
    done = stage(
        menagerie, "collect", *arguments, f"collect.references={tmp_path / 'a1'}", f"collect.out={tmp_path / 'jumps'}"
    )
    assert done.returncode == 0, done.stderr
    jump = read_log(tmp_path / "jumps" / "ideal_00.parquet")
    assert jump.info.robot == "go2"
    assert jump["base_pos_x"][-1] - jump["base_pos_x"][0] == pytest.approx(0.4, abs=0.12)


def test_a_file_serves_only_the_robot_it_was_planned_for(tmp_path: Path, menagerie: Path, robot: Robot) -> None:
    other = planar_robot(Robot.load(menagerie / "unitree_go2" / "scene.xml"))
    write_log(reference_to(TARGET, tmp_path, planar_robot(robot)), tmp_path / f"{name_of(TARGET)}.parquet")
    assert reference_to(TARGET, tmp_path, other).info.robot == "go2"


def test_published_plans_are_for_their_own_robot(menagerie: Path, robot: Robot) -> None:
    go2 = Robot.load(menagerie / "unitree_go2" / "scene.xml")
    assert select_planar_robot(None, robot) == select_planar_robot("published", robot) == PlanarRobot()
    assert select_planar_robot(None, go2) == select_planar_robot("own", go2) == planar_robot(go2)
    with pytest.raises(
        InputError, match=r"plans are of the a1 with 11\.9 kg; expected own: .* another robot, 15\.2 kg"
    ):
        select_planar_robot("published", go2)


def test_methods_with_published_plans_are_left_out_for_another_robot(
    menagerie: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    go2 = Robot.load(menagerie / "unitree_go2" / "scene.xml")
    settings = SimpleNamespace(published="nowhere", schedule=ContactSchedule())
    rig = Rig(settings, {}, SimpleNamespace(robot=go2, references={TARGET: None}), (), RigidBody(15.2, 0.4))  # type: ignore[arg-type]
    assert rig.plans(PlanSource.published) is None
    assert "no published plans are of" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["optimize", "collect", "land"])
def test_a_robot_that_cannot_jump_is_refused_in_one_message(tmp_path: Path, menagerie: Path, name: str) -> None:
    before = tmp_path / "out" / "landings.csv"
    done = stage(menagerie, name, f"robot.model={write_model(tmp_path)}", f"{name}.out={before.parent}")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "found no free base, 0 legs front and 0 legs rear; expected a free base, two legs front" in done.stderr
    assert not before.parent.exists()


def test_a_diagnosis_is_of_the_chosen_robot(tmp_path: Path, menagerie: Path, robot: Robot) -> None:
    write_log(standing(robot, 1300), tmp_path / "logs" / "jump.parquet")
    done = stage(
        menagerie, "diagnose", "robot=go2", f"diagnose.logs={tmp_path / 'logs'}", f"diagnose.out={tmp_path / 'r'}"
    )
    assert done.returncode == 2
    assert "FR_hip_joint" in done.stderr
