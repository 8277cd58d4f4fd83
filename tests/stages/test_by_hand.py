"""Stages called by hand: what a user types, and what a user gets when it cannot work."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.task import target_of
from leapgap.logs import log as jump_log
from leapgap.robot.model import Robot
from tests.commands import assert_refused, stage
from tests.conftest import standing
from tests.logs.test_importers import write_published


@pytest.fixture
def logs(tmp_path: Path, robot: Robot) -> Path:
    """Two logs of a robot that stands and swings one calf."""
    turn, calf = 2 * np.pi * np.arange(1300) / 1000, standing(robot, 1300)["joint_pos/FR_calf"]
    for i, size in enumerate((0.03, 0.05)):
        swing = {"joint_pos/FR_calf": calf + size * (1 - np.cos(turn))}
        swing["joint_vel/FR_calf"] = size * 2 * np.pi * np.sin(turn)
        jump_log.write_log(standing(robot, 1300, **swing), tmp_path / "logs" / f"jump_{i}.parquet")
    return tmp_path / "logs"


def test_an_environment_without_the_pipeline_is_told_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['hydra'] = None\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    assert_refused(stage("land"), "found no hydra-core", "make .venv/ready", "leapgap[pipeline]")


def test_import_of_foreign_logs(tmp_path: Path, robot: Robot) -> None:
    write_published(tmp_path / "raw" / "3", robot)
    out = tmp_path / "jumps"
    result = stage(
        "import_logs",
        f"import_logs.source={tmp_path / 'raw'}",
        f"import_logs.out={out}",
        "import_logs.format=published",
    )
    assert result.returncode == 0, result.stderr
    assert "1 logs imported" in result.stdout
    assert target_of(jump_log.read_log(out / "jump_03.parquet")).x_m == 0.6


def test_no_logs_is_a_stated_result(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    for arguments in (
        ("import_logs", f"import_logs.source={tmp_path / 'raw'}", f"import_logs.out={tmp_path / 'a'}"),
        ("diagnose", f"diagnose.logs={tmp_path / 'a'}", f"diagnose.out={tmp_path / 'b'}"),
    ):
        result = stage(*arguments)
        assert result.returncode == 0, result.stderr
        assert "no logs" in result.stdout


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("collect", "collect.jmps=3"), ("collect.jmps",)),
        (("collect", "collect.jumps=some"), ("collect.jumps", "'some'")),
        (("collect", "collect.hardware=brandnew"), ("collect.hardware: found brandnew; expected one of ideal",)),
        (("collect", "collect.variants.damped.effects=[{name:joint_dampng}]"), ("found joint_dampng",)),
        (("diagnose", "diagnose.settings.effects=[nonsense]", "diagnose.logs={logs}"), ("found nonsense",)),
        (("diagnose", "diagnose.logs=nowhere"), ("nowhere: found no such folder",)),
        (("diagnose", "diagnose.logs={logs}", "diagnose.robot=nowhere.xml"), ("nowhere.xml: found no such file",)),
        (("import_logs", "import_logs.format=bags"), ("found bags; expected one of csv, hdf5",)),
        (("import_logs", "import_logs.source=nowhere"), ("import_logs.source: found nowhere",)),
        (("optimize", "optimize.targets=[[9.0,0.0]]"), ("9",)),
        (("chunk", "chunk.logs={logs}", "chunk.flight_step_s=0.07"), ("flight",)),
        (("chunk", "size=enormous"), ("enormous",)),
    ],
)
def test_bad_input_is_told_in_one_message(logs: Path, tmp_path: Path, arguments: tuple, parts: tuple) -> None:
    name = arguments[0]
    filled = [argument.replace("{logs}", str(logs)) for argument in arguments[1:]]
    assert_refused(stage(name, *filled, f"{name}.out={tmp_path / 'out'}"), *parts)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("harm", "part"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:3000]), "no readable Parquet"),
        (lambda path: path.write_text("time,x\n0,1\n"), "no readable Parquet"),
    ],
)
def test_a_damaged_log_stops_every_stage_that_reads_it(logs: Path, tmp_path: Path, harm, part: str) -> None:
    harm(logs / "jump_1.parquet")
    for name in ("chunk", "diagnose"):
        result = stage(name, f"{name}.logs={logs}", f"{name}.out={tmp_path / name}")
        assert_refused(result, "jump_1.parquet", part, lines=3)  # the bad logs have a line each
        assert not (tmp_path / name).exists()


def test_a_damaged_raw_jump_leaves_the_imported_ones_as_they_were(tmp_path: Path, robot: Robot) -> None:
    write_published(tmp_path / "raw" / "3", robot)
    out = tmp_path / "jumps"
    arguments = ("import_logs", f"import_logs.source={tmp_path / 'raw'}", f"import_logs.out={out}")
    assert stage(*arguments).returncode == 0
    before = (out / "jump_03.parquet").read_bytes()
    (tmp_path / "raw" / "3" / "torque.txt").unlink()
    assert_refused(stage(*arguments), "torque.txt: found no such file")
    assert sorted(path.name for path in out.iterdir()) == [".leapgap.json", "jump_03.parquet"]
    assert (out / "jump_03.parquet").read_bytes() == before


@pytest.mark.long  # every run of the tests has a sweep of trainings, in test_sweep.py
def test_multirun_sweeps(tmp_path: Path) -> None:
    result = stage(
        "collect",
        "-m",
        "collect.hardware=ideal,damped",
        "collect.jumps=1",
        "collect.targets=[[0.4,0.0]]",
        f"hydra.sweep.dir={tmp_path}",
    )
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "0" / "out" / "ideal_00.parquet").exists()
    assert (tmp_path / "1" / "out" / "damped_00.parquet").exists()


def test_a_corrected_robot_can_be_simulated(tmp_path: Path, robot: Robot) -> None:
    from leapgap import effects
    from leapgap.simulation.corrected import write_corrected

    write_corrected(tmp_path / "corrected", robot, (effects.effect("joint_damping", damping=0.4),))
    common = ("collect.jumps=1", "collect.targets=[[0.4,0.0]]")
    for out, extra in (
        ("a", (f"collect.robot={tmp_path / 'corrected'}", "collect.hardware=ideal")),
        ("b", ("collect.hardware=damped",)),
    ):
        assert stage("collect", *common, *extra, f"collect.out={tmp_path / out}").returncode == 0
    made = [jump_log.read_log(next((tmp_path / out).glob("*.parquet"))) for out in "ab"]
    assert (made[0]["base_pos_x"] == made[1]["base_pos_x"]).all()


def test_a_corrected_robot_can_be_planned_for_unless_plans_cannot_express_it(tmp_path: Path, robot: Robot) -> None:
    """A plan that reckons with damping costs more torque; one cannot reckon with commands that arrive late."""
    from leapgap import effects
    from leapgap.simulation.corrected import write_corrected

    damped, late = effects.effect("joint_damping", damping=0.4), effects.effect("command_delay", delay_s=0.003)
    write_corrected(tmp_path / "damped", robot, (damped,))
    write_corrected(tmp_path / "late", robot, (damped, late))
    costs = []
    for name, chosen in (("own", "optimize.planar=own"), ("corrected", f"optimize.robot={tmp_path / 'damped'}")):
        result = stage("optimize", "optimize.targets=[[0.4,0.0]]", chosen, f"optimize.out={tmp_path / name}")
        assert result.returncode == 0, result.stderr
        costs.append(json.loads((tmp_path / name / "references.json").read_text())[0]["cost"])
    assert costs[1] > costs[0] + 1
    result = stage("optimize", f"optimize.robot={tmp_path / 'late'}", f"optimize.out={tmp_path / 'none'}")
    assert_refused(result, "command_delay at all", "joint_damping")
    assert not (tmp_path / "none").exists()
