"""A motion that becomes unstable while it is tried out says nothing, and MuJoCo warns as before afterwards."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.working_models import without_warnings
from tests.effects import moving_arm as arm


@pytest.fixture(autouse=True)
def of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes its log to the working folder."""
    monkeypatch.chdir(tmp_path)


def test_an_unstable_trial_leaves_no_words_and_no_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    robot = arm.load(tmp_path)
    log = arm.as_log("thrown", arm.SENT, *arm.simulate(arm.SENT))
    motion = Replayer(robot).motions([Rollout(log, first_state=np.full(6, 1e12))])[0]
    printed = capfd.readouterr()
    assert np.isfinite(motion.qpos).all()
    assert not (printed.out + printed.err)
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]


def test_rotors_that_begin_an_unstable_trial_leave_no_words(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    robot = arm.load(tmp_path)
    log, play = arm.as_log("thrown", arm.SENT, *arm.simulate(arm.SENT)), effects.effect("joint_play", play_rad=0.01)
    replayer, trial = Replayer(robot), Rollout(log, (play,))
    controls = replayer.step_controls(trial, replayer.row_steps(trial), slice(None))[None]
    assert np.isfinite(replayer.whole_states(trial, replayer.model(trial), np.full((1, 6), 1e12), controls)).all()
    assert not "".join(capfd.readouterr())
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]


def test_what_is_outside_a_trial_still_warns(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = mujoco.MjModel.from_xml_string(arm.MJCF)
    data = mujoco.MjData(model)
    with without_warnings(), without_warnings():
        pass
    data.qvel[:] = 1e12
    mujoco.mj_step(model, data)
    assert "unstable" in capfd.readouterr().err
    assert (tmp_path / "MUJOCO_LOG.TXT").is_file()
