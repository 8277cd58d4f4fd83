"""The exported C is told any bits for numbers, under sanitizers: it does not fail, and motors get what they can do."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.jumping.export.conftest import RecordedJump, raw
from tests.jumping.export.test_force_controller import export_learned

MOTOR_NM = 33.5
"""Largest torque of the A1's motors."""
SANITIZERS = ("-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
BAD = (np.nan, np.inf, -np.inf, 1e200, -1e200, 1e9, -1e9, 0.0)
JUMPS = 12


@pytest.fixture(scope="module")
def learned_folder(robot: Robot, reference: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An export of the learned MPC."""
    folder = tmp_path_factory.mktemp("learned")
    export_learned(robot, reference, folder)
    return folder


@pytest.fixture(params=["folder", "late_folder", "learned_folder"])
def guarded(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """An export, compiled to end at a wrong index, an overflow or a number without a whole one."""
    sources = [str(path) for path in sorted(request.getfixturevalue(request.param).glob("*.c"))]
    out = tmp_path / "jump"
    try:
        done = subprocess.run(["gcc", "-O1", *SANITIZERS, *sources, "-o", str(out), "-lm"], capture_output=True)
    except FileNotFoundError:
        pytest.skip("no gcc")
    if done.returncode:
        pytest.skip("this compiler has no sanitizers")
    return out


def harmed(ticks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Ticks (rows, 26) of which a share has random bits, values that none has measured, or noise of any size."""
    ticks, bad = ticks.copy(), rng.random(len(ticks)) < rng.choice([0.02, 0.3, 0.9])
    for row in np.flatnonzero(bad):
        where = rng.integers(ticks.shape[1], size=rng.integers(1, 10))
        bits = rng.integers(0, 2**64, len(where), dtype=np.uint64).view(float)
        noisy = ticks[row, where] + rng.normal(size=len(where)) * 10.0 ** rng.integers(-3, 4)
        ticks[row, where] = (bits, rng.choice(BAD, len(where)), noisy)[int(rng.integers(3))]
    return ticks


@pytest.mark.long
def test_any_bits_get_finite_commands_within_the_motors(jump: RecordedJump, guarded: Path) -> None:
    rng, truth = np.random.default_rng(3), np.frombuffer(raw(jump.estimates)).reshape(len(jump.estimates), -1)
    for _ in range(JUMPS):
        told = harmed(truth, rng)
        done = subprocess.run([str(guarded)], input=told.tobytes(), capture_output=True)
        assert (done.returncode, done.stderr.decode()) == (0, "")
        sent = np.frombuffer(done.stdout).reshape(len(told), -1)
        assert np.isfinite(sent).all()
        assert np.abs(sent[:, :12]).max() <= MOTOR_NM + 1e-9
        assert sent[:, 36:60].min() >= 0, "gains"
