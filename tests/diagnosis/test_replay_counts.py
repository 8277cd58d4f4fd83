"""How often whole jumps are replayed in a diagnosis, and that replays of all rows begin as those of the judged ones."""

from collections import Counter

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.horizons import RestartedReplayer
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.measurements import SamplePeriod
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import SensorNoise
from tests.diagnosis.test_diagnose import FEW
from tests.diagnosis.test_gap import hardware


@pytest.fixture(scope="module")
def damped_logs(robot: Robot, reference: Log) -> list[Log]:
    return hardware(robot, reference, effects.effect("joint_damping", damping=0.4), noise=SensorNoise(), jumps=3)


@pytest.mark.long
def test_no_whole_jump_is_replayed_twice_with_the_same_effects(
    robot: Robot, damped_logs: list[Log], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the log's first row, at the nominal step: each set of effects once, the nominal robot among them."""
    asked: Counter[tuple[str, tuple[object, ...]]] = Counter()
    original = Replayer.true_motions

    def counting(self: Replayer, trials: list[Rollout], rows: int | None = None) -> list[object]:
        for trial in trials:
            if trial.first_state is None and len(trial.log) > 500 and self.largest_step_s > 0.001:
                asked[trial.log.name, trial.effects] += 1
        return original(self, trials, rows)  # type: ignore[return-value]

    monkeypatch.setattr(Replayer, "true_motions", counting)
    restarted: list[float] = []
    monkeypatch.setattr(RestartedReplayer, "motions", lambda self, *_: restarted.append(self.horizon_s))
    found = diagnose(damped_logs, robot, FEW)
    assert restarted == []  # jumps are judged as whole logs
    assert found.report.answer
    assert asked[damped_logs[0].name, ()] == 1
    assert set(asked.values()) == {1}


def test_a_profile_of_the_judged_rows_goes_on_with_its_last_value() -> None:
    """On a longer log the first rows last as long as they did on the rows it was found on."""
    found = SamplePeriod(scale=1.1, profile=(0.9, 1.2, 1.0))
    judged, whole = found.change_rows(np.ones(700)), found.extend_to(700, 1000).change_rows(np.ones(1000))
    assert np.array_equal(whole[:700], judged)
    assert set(whole[700:]) == {1.0}
    assert found.change_rows(np.ones(1000))[:700] != pytest.approx(judged, abs=0.02)  # what stretching would do


def test_replays_of_all_rows_begin_as_those_of_the_judged_rows(robot: Robot, damped_logs: list[Log]) -> None:
    judged, replayer = JudgedLogs.of(damped_logs, robot), Replayer(robot)
    effect = SamplePeriod(scale=1.05, profile=(0.95, 1.1, 0.98))
    for jump, cut in zip(damped_logs, judged.logs, strict=True):
        (whole,) = replayer.motions([Rollout(jump, (effect.extend_to(len(cut), len(jump)),))])
        (part,) = replayer.motions([Rollout(cut, (effect,))])
        assert np.array_equal(whole.qpos[: len(cut)], part.qpos)
