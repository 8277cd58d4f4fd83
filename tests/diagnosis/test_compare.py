"""What changed between two sets of logs, of arms that plain MuJoCo simulates, whose model is wrong in both."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ttest_ind

import leapgap as lg
from leapgap import effects
from leapgap.cli import main
from leapgap.diagnosis.compare import Difference, PairedBench, PairedSearch, stands_out
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judge import RefereedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import read_logs
from leapgap.robot.model import Robot
from tests import plain_arm

STICKY, STICKIER = (f'damping="0.05" frictionloss="{torque}"' for torque in (0.6, 0.9))
"""The model has no dry friction at all."""


def logs_of(folder: Path, before: str, after: str) -> tuple[Path, Path]:
    """Two logs each, of motions that are not repeated."""
    return plain_arm.write_parquet(folder / "a", 2, before), plain_arm.write_parquet(folder / "b", 2, after, 10)


@pytest.mark.long
def test_an_error_that_both_sets_share_is_no_change(tmp_path: Path) -> None:
    robot = Robot.load(plain_arm.write_model(tmp_path))
    before, after = logs_of(tmp_path, plain_arm.arm(STICKY), plain_arm.arm(STICKY))
    found = lg.compare(before, after, robot, threads=1)
    assert found.changed == ()
    assert not found.unknown_change
    friction = float(found.smallest["joint_friction"].removeprefix("torque_nm ").removesuffix(" N·m"))
    assert friction < 0.1  # a third of the change below, which is named


@pytest.mark.long
def test_what_changed_is_named_by_how_much_and_not_what_both_lack(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = plain_arm.write_model(tmp_path)
    before, after = logs_of(tmp_path, plain_arm.arm(STICKY), plain_arm.arm(STICKIER))
    file = tmp_path / "changed.json"
    assert main(["compare", str(before), str(after), str(model), "--json", str(file), "--quiet"]) == 0
    assert "changed: joint Coulomb friction at elbow (torque 0.3" in capsys.readouterr().out
    (change,) = json.loads(file.read_text())["changed"]
    (low, high) = change["ci95"][0]
    assert low < 0.3 < high
    assert high - low < 0.15


def test_a_single_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = plain_arm.write_model(tmp_path)
    logs = plain_arm.write_parquet(tmp_path / "logs", 2)
    one = plain_arm.write_parquet(tmp_path / "one", 1)
    assert main(["compare", str(one), str(logs), str(model)]) == 2
    assert "before: found 1 log; expected two or more" in capsys.readouterr().err


def test_a_difference_acts_after_alone_with_one_structure_in_all_logs(tmp_path: Path) -> None:
    """Replays of all logs lie side by side, so that a motor with a lag has its state before, too."""
    robot = Robot.load(plain_arm.write_model(tmp_path))
    friction, lag = (
        Difference.of(Hypothesis(effects.known()[name], robot, "elbow"), frozenset({"late"}))
        for name in ("joint_friction", "motor_lag")
    )
    assert friction.on("early", np.array([0.3])).is_nominal
    assert friction.on("late", np.array([0.3])).values == {"torque_nm": 0.3}
    before, after = (lag.on(log, np.array([0.02])) for log in ("early", "late"))
    assert before.structure == after.structure is not None
    assert 0 < before.values["time_constant_s"] < 1e-9 < after.values["time_constant_s"]
    assert friction.name != friction.kind.called(robot)  # both may act at once


def test_one_difference_takes_the_place_of_two_that_say_as_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More friction at the elbow is also more at all joints and less at the shoulder, which stuck before."""
    monkeypatch.setattr(plain_arm, "swing", partial(plain_arm.swing, seconds=0.5))
    sticky = 'name="shoulder" axis="0 1 0" damping="0.05" frictionloss="0.5"'
    own, robot = plain_arm.arm(), Robot.load(plain_arm.write_model(tmp_path))
    before, after = (
        xml.replace('name="shoulder" axis="0 1 0" damping="0.05"', sticky)
        for xml in (own, plain_arm.arm('damping="0.05" frictionloss="0.54"'))
    )
    sets = [read_logs(folder) for folder in logs_of(tmp_path, before, after)]
    logs = [replace(log, name=f"{name} {log.name}") for name, of in zip("ab", sets, strict=True) for log in of]
    names = ["joint_friction", "friction_compensation", "joint_damping"]
    bench = RefereedLogs.of("compare", logs, robot, Settings(effects=names), 1).bench
    later = frozenset(log.name for log in logs[2:])
    changes = {h.label: Difference.of(h, later) for h in bench.hypotheses}
    paired = PairedBench(
        [*changes.values()], bench.tolerances, bench.states, bench.replayer, bench.hypotheses, later, cancels=True
    )
    search = PairedSearch(paired, np.array([0, 1, 0, 1]), lambda _: None)
    both = [(changes[label], np.array([0.5])) for label in ("joint_friction", "friction_compensation at shoulder")]
    found = search.merged(search.settle(search.moved(paired.nominal(), tuple(both))))
    assert found.members == (changes["joint_friction at elbow"],)
    assert found.numbers == pytest.approx([0.54], rel=0.1)
    assert search.is_steady(found, 0)


@pytest.mark.long
def test_what_differs_from_log_to_log_is_no_change(tmp_path: Path) -> None:
    """Friction of 0.5, 0.9, 0.6 and 1.1 N·m: the later two logs have more of it, and no more than logs differ."""
    robot = Robot.load(plain_arm.write_model(tmp_path))
    for seed, (name, torque) in enumerate((("a", 0.5), ("a", 0.9), ("b", 0.6), ("b", 1.1))):
        xml = plain_arm.arm(f'damping="0.05" frictionloss="{torque}"')
        plain_arm.write_parquet(tmp_path / name, 1, xml, seed)
    found = lg.compare(tmp_path / "a", tmp_path / "b", robot, threads=1)
    assert found.changed == ()


@pytest.mark.parametrize("apart", [0.3, 1.0, 3.0, 10.0])
def test_a_difference_stands_out_as_in_the_test_of_student(apart: float) -> None:
    rng = np.random.default_rng(int(10 * apart))
    before, after = 0.3 * rng.standard_normal(3), apart + 0.3 * rng.standard_normal(4)
    assert stands_out(before, after) == (ttest_ind(before, after).pvalue < 0.01)
