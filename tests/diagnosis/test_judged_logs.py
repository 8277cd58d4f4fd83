"""What is known of the logs is computed once: states, noise, and the noise of the starts of replays."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from leapgap.diagnosis import judged_logs
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.localisation import localise
from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs import state
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from tests.diagnosis import pd_arms
from tests.diagnosis.test_other_motions import ACROBOT, even, swing, without_velocities

LOGS = 3


@pytest.fixture(scope="module")
def acrobot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("acrobot") / "acrobot.xml"
    path.write_text(ACROBOT.format(friction=0.0))
    return Robot.load(path)


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    return [without_velocities(swing(seed, even(500, 1.0), 0.0, kp=20.0, kd=0.3)) for seed in range(LOGS)]


def count(monkeypatch: pytest.MonkeyPatch, calls: Counter[str], module: Any, name: str) -> None:
    original = getattr(module, name)

    def counting(*arguments: Any, **named: Any) -> Any:
        calls[name] += 1
        return original(*arguments, **named)

    monkeypatch.setattr(module, name, counting)


def test_noise_and_fits_of_a_log_are_computed_once(
    acrobot: Robot, logs: list[Log], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not once for every piece: ten pieces a log are replayed here."""
    calls = Counter[str]()
    count(monkeypatch, calls, judged_logs, "sensor_noise")
    count(monkeypatch, calls, state, "add_velocities")
    judged = JudgedLogs.of(logs, acrobot)
    localise(judged, Replayer(acrobot), 0.1, 2, np.random.default_rng(0))
    assert calls == {"sensor_noise": LOGS, "add_velocities": LOGS}


def test_a_log_keeps_nothing_that_others_computed_from_it(acrobot: Robot, logs: list[Log]) -> None:
    """A log that is read by two robots must not know the first one's states."""
    own = Log(logs[0].name, logs[0].columns, logs[0].info)
    judged = JudgedLogs.of([own], acrobot)
    fields = {"name", "columns", "info"}
    computed_by_itself = {name for name in vars(Log) if not name.startswith("__")}
    for log in (own, *judged.logs):
        assert set(vars(log)) <= fields | computed_by_itself


def test_starts_are_as_noisy_as_positions_and_fitted_velocities(acrobot: Robot, logs: list[Log]) -> None:
    """Positions have noise of 0.2 mrad; a slope over 30 ms at 500 Hz is 28 times as noisy per s as they are."""
    judged = JudgedLogs.of(logs, acrobot)
    middle, end = judged.start_noise(0, 250), judged.start_noise(0, 0)
    assert middle[:2] == pytest.approx([2e-4, 2e-4], rel=0.3)
    # The slope of n rows h apart has the deviation sigma sqrt(12 / n³) / h; 15 or 16 rows are within 30 ms.
    assert middle[2:] == pytest.approx(middle[:2] * np.sqrt(12 / 15.5**3) / 0.002, rel=0.2)
    assert (end[2:] > 3 * middle[2:]).all()


@pytest.mark.parametrize("rows", [2, 5, 12, 20])
def test_logs_shorter_than_a_horizon_are_refused(rows: int, tmp_path: Path) -> None:
    logs = [log.first_rows(rows) for log in pd_arms.logs(number=2, seconds=2.0)]
    with pytest.raises(InputError, match=r"s at most; expected more than 0\.1 s; log longer motions"):
        diagnose(logs, pd_arms.robot(tmp_path), Settings())
