"""A robot of twice the mass is planned for, and lands, with its own mass and not with the A1's."""

import re
from pathlib import Path

import numpy as np
import pytest

from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.commands import stage

GRAVITY = 9.81
A1_KG = 12.453


def double_numbers(match: re.Match) -> str:
    return f'{match[1]}="{" ".join(repr(2 * float(number)) for number in match[2].split())}"'


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory, robot: Robot) -> Path:
    """The A1 with every mass and every inertia twice as large."""
    text = robot.path.read_text()
    path = tmp_path_factory.mktemp("heavy") / "heavy.xml"
    path.write_text(re.sub(r'\b(mass|fullinertia|diaginertia)="([^"]*)"', double_numbers, text))
    mass = Robot.load(path).model.body_mass.sum()
    assert mass == pytest.approx(2 * robot.model.body_mass.sum())
    assert mass == pytest.approx(2 * A1_KG, abs=0.01)
    return path


@pytest.fixture(scope="module")
def references(tmp_path_factory: pytest.TempPathFactory, reference: Log) -> Path:
    """The A1's plan: a pose to stand in and a motion to follow are all that is needed of it."""
    folder = tmp_path_factory.mktemp("references")
    jump_log.write_log(reference, folder / "h00_d50.parquet")
    return folder


def upward(log: Log, row: int) -> float:
    """Planned vertical force of both pairs at a row, N."""
    return float(log["mpc_force/front_z"][row] + log["mpc_force/rear_z"][row])


@pytest.mark.parametrize("model", ["heavy", "a1"])
def test_collect_holds_up_and_stands_with_the_robots_own_weight(
    model: str, heavy: Path, robot: Robot, references: Path, tmp_path: Path
) -> None:
    """The first force of the nominal MPC, at rest, and the force that it stands with after its landing."""
    path, mass_kg = (heavy, 2 * A1_KG) if model == "heavy" else (robot.path, A1_KG)
    result = stage(
        "collect",
        f"robot.model={path}",
        f"collect.references={references}",
        *("collect.controller=nominal_mpc", "collect.hardware=ideal", "collect.jumps=1"),
        *("collect.targets=[[0.5,0.0]]", f"collect.out={tmp_path / 'out'}", "executor=local"),
    )
    assert result.returncode == 0, result.stderr
    log = jump_log.read_log(tmp_path / "out" / "ideal_00.parquet")
    assert upward(log, 0) == pytest.approx(mass_kg * GRAVITY, rel=0.25)
    assert upward(log, -1) == pytest.approx(mass_kg * GRAVITY, rel=1e-3)


def test_land_predicts_and_stands_with_the_robots_own_weight(heavy: Path, references: Path, tmp_path: Path) -> None:
    result = stage(
        "land",
        "size=tiny",
        f"robot.model={heavy}",
        f"land.references={references}",
        *("land.methods=[nominal_variable]", "land.hardware=[worn]", "land.tasks.block_60.repeats=0"),
        *(f"land.out={tmp_path}", "executor=local"),
    )
    assert result.returncode == 0, result.stderr
    log = jump_log.read_log(tmp_path / "runs/worn/nominal_variable/jump_50_0.parquet")
    assert upward(log, 0) == pytest.approx(2 * A1_KG * GRAVITY, rel=0.25)
    touching = np.flatnonzero(log.stack(["contact/FR", "contact/FL", "contact/RR", "contact/RL"]).all(axis=1))
    assert upward(log, touching[-1]) == pytest.approx(2 * A1_KG * GRAVITY, rel=1e-3)
