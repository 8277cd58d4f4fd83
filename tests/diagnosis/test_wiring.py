"""Columns that are not what their names say, in all logs alike; and silence where causes alone are at work."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from leapgap.diagnosis.checks.base import CheckResult
from leapgap.diagnosis.checks.set_points import SetPoints
from leapgap.diagnosis.checks.wiring import Wiring
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests import plain_simulation
from tests.diagnosis import pd_arms
from tests.diagnosis.pd_arms import JOINTS, Truth
from tests.robot import quadrupeds

Columns = dict[str, np.ndarray]
MEASURED, POINTS = ("joint_pos", "joint_vel"), ("cmd_pos", "cmd_vel")
GAINS = ("cmd_kp", "cmd_kd", "cmd_tau")


def times(factor: float, quantities: Sequence[str], *joints: str) -> Callable[[Columns], Columns]:
    return lambda columns: {f"{of}/{j}": factor * columns[f"{of}/{j}"] for of in quantities for j in joints}


def moved(source: dict[str, str], quantities: Sequence[str]) -> Callable[[Columns], Columns]:
    return lambda columns: {f"{of}/{j}": columns[f"{of}/{k}"] for of in quantities for j, k in source.items()}


def checked(logs: Sequence[Log], robot: Robot) -> CheckResult:
    result = Wiring().run(logs, robot, Wiring.threshold)
    assert result is not None
    return result


SWAP = {"shoulder": "elbow", "elbow": "shoulder"}
TURN = {"base": "shoulder", "shoulder": "elbow", "elbow": "base"}
EVERY = (*MEASURED, *POINTS, *GAINS)
WRONG = {
    "shoulder and elbow exchanged": (moved(SWAP, EVERY), 10),
    "commands of shoulder and elbow exchanged": (moved(SWAP, (*POINTS, *GAINS)), 10),
    "measurements of shoulder and elbow exchanged": (moved(SWAP, MEASURED), 10),
    "base, shoulder, elbow being elbow, base, shoulder": (moved(TURN, EVERY), 10),
    "set points of shoulder with the other sign": (times(-1, POINTS, "shoulder"), 10),
    "measurements of elbow with the other sign": (times(-1, MEASURED, "elbow"), 10),
    "shoulder turned round": (times(-1, (*MEASURED, *POINTS), "shoulder"), 10),
    "set points of elbow in degrees": (times(180 / np.pi, POINTS, "elbow"), 10),
    "base, shoulder, elbow in degrees": (times(180 / np.pi, (*MEASURED, *POINTS), *JOINTS), 10),
}


@pytest.mark.parametrize("says", WRONG)
def test_what_is_mixed_up_is_read_as_it_is(says: str, tmp_path: Path) -> None:
    change, least = WRONG[says]
    result = checked([pd_arms.changed(log, change) for log in pd_arms.logs()], pd_arms.robot(tmp_path))
    assert not result.passed and result.says.startswith(f"read as {says}, the gap is "), result.says
    assert result.statistic > least


def test_a_sign_is_told_beside_other_causes(tmp_path: Path) -> None:
    logs = pd_arms.logs(Truth(gains=2.0, damping=0.5, mass=1.3))
    result = checked([pd_arms.changed(log, times(-1, POINTS, "elbow")) for log in logs], pd_arms.robot(tmp_path))
    assert result.says.startswith("read as set points of elbow with the other sign, the gap is ")


CAUSES = {
    "nothing": {},
    "gains of four times": {"gains": 4.0},
    "gains of a third": {"gains": 0.3},
    "gains of a twentieth": {"gains": 0.05},
    "late by 100 ms": {"delay_s": 0.1},
    "damping": {"damping": 3.0},
    "friction": {"friction": 3.0},
    "thrice the mass": {"mass": 3.0},
    "weak motors": {"limit": 4.0},
    "all": {"gains": 3.0, "delay_s": 0.05, "damping": 1.0, "friction": 0.5, "mass": 2.0},
}


@pytest.mark.parametrize("cause", CAUSES)
def test_causes_are_no_wiring(cause: str, tmp_path: Path) -> None:
    result = checked(pd_arms.logs(Truth(**CAUSES[cause])), pd_arms.robot(tmp_path))
    assert result.passed, result.says
    assert result.says == "no other sign, unit or order of the joints' columns fits the model better"


def quadruped_logs(folder: Path, **wrong: float) -> tuple[list[Log], Robot]:
    """Go2 in the air and on its feet, its joints pulled about by a PD; the file says less than the robot is."""
    path = quadrupeds.write(quadrupeds.GO2, folder)

    def change(model) -> None:  # type: ignore[no-untyped-def]
        model.dof_damping[6:] *= wrong.get("damping", 1.0)
        model.body_mass[:] *= wrong.get("mass", 1.0)
        model.body_inertia[:] *= wrong.get("mass", 1.0)

    logs = []
    for k, lift in enumerate((0.4, 0.45)):
        pd = plain_simulation.Pd(kp=40.0 * wrong.get("gains", 1.0), kd=1.0, push=0.5)
        log = plain_simulation.simulate(path, plain_simulation.by_force, pd, 301, lift, change=change).log
        kp = {name: values / wrong.get("gains", 1.0) for name, values in log.columns.items() if "cmd_kp" in name}
        logs.append(Log(f"log_{k}", {**log.columns, **kp}, log.info))
    return logs, Robot.load(path)


@pytest.mark.parametrize("wrong", [{}, {"mass": 1.5, "damping": 0.2}, {"gains": 4.0}])
def test_a_quadruped_with_wrong_numbers_is_wired_rightly(wrong: dict, tmp_path: Path) -> None:
    result = checked(*quadruped_logs(tmp_path, **wrong))
    assert result.passed, result.says


def test_the_order_of_a_quadruped_kind_by_kind_is_told(tmp_path: Path) -> None:
    """Isaac Lab's order, with names given limb by limb."""
    logs, robot = quadruped_logs(tmp_path)
    by_kind = [robot.joints[3 * limb + k] for k in range(3) for limb in range(4)]
    source = dict(zip(robot.joints, by_kind, strict=True))
    result = checked([pd_arms.changed(log, moved(source, EVERY)) for log in logs], robot)
    assert not result.passed and "joints in the order" in result.says and "kind by kind" in result.says


@pytest.mark.parametrize("rows", [0, 1])
def test_set_points_that_are_measurements_say_nothing_of_commands(rows: int) -> None:
    def copy(columns: Columns) -> Columns:
        return {"cmd_pos/elbow": np.roll(columns["joint_pos/elbow"], rows)}

    result = SetPoints().run([pd_arms.changed(log, copy) for log in pd_arms.logs(number=2)], None, 0.0)
    assert result is not None and not result.passed and result.statistic == 1
    assert result.says.startswith("set points of elbow are the measured positions: ")


@pytest.mark.parametrize(("factor", "says"), [(180 / np.pi, "0.0175 times"), (-1.0, "-1 times")])
def test_set_points_of_two_units_or_directions(factor: float, says: str) -> None:
    logs = [pd_arms.changed(log, times(factor, ("cmd_vel",), "base")) for log in pd_arms.logs(number=2)]
    result = SetPoints().run(logs, None, 0.0)
    assert result is not None and f"set points of base move {says} as far as their velocities say" in result.says


def test_healthy_set_points_pass() -> None:
    result = SetPoints().run(pd_arms.logs(Truth(gains=4.0), number=2), None, 0.0)
    assert result is not None and result.passed
