"""The stage that exports a controller: a small practice, and files that a compiler takes."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.commands import assert_refused, stage

SMALL = (
    "size=tiny",
    "land.practice={identify_jumps: 1, random_jumps: 4, rounds: []}",
    "+land.method_settings.learned_goal_mpc={kind: learned_goal_mpc,"
    " simulated: {goals: 4, kicks: 6, probed_x_m: [0.5]}, held: {distances_m: [0.5], last_updates: 1}}",
    "export.target=[0.5,0.0]",
    "executor=local",
)


@pytest.mark.long
@pytest.mark.pipeline
def test_a_robot_practises_and_its_controller_compiles(tmp_path: Path) -> None:
    out = tmp_path / "controller"
    result = stage("export", *SMALL, f"export.landings={tmp_path / 'none'}", f"export.out={out}")
    assert result.returncode == 0, result.stderr
    about = json.loads((out / "controller.json").read_text())
    assert about["stance_is_measured"] and "measures the slope" in result.stdout
    assert (about["hardware"], about["target_m"]) == ("worn", {"x": 0.5, "z": 0.0})
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    subprocess.run("gcc *.c -o jump -lm", shell=True, cwd=out, check=True)
    answer = subprocess.run([str(out / "jump")], input=b"", capture_output=True, check=True)
    assert answer.stdout == b""


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    result = stage("export", "export.method=joint_pd", f"export.out={tmp_path / 'out'}", "executor=local")
    assert_refused(result, "export.method: found joint_pd", "learned_goal_mpc")
    assert not (tmp_path / "out").exists()
