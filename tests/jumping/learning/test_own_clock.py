"""Windows by a log's own clock, and models by either clock, on a point mass whose true motion is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.learning import evaluation, window_extraction, windows
from leapgap.jumping.learning.evaluation import HeldOutPredictions
from leapgap.jumping.learning.model import Model, Nominal
from leapgap.jumping.learning.models.nominal import NominalModel
from leapgap.jumping.learning.windows import ARRAYS, TimeGrid, Windows
from leapgap.logs.row_clock import RowClock
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json
from stages.train import train
from tests.benchmarks import clock_comparison
from tests.benchmarks.clock_comparison import CLAIMED, EXPECTED, OWN
from tests.conftest import A1_BODY
from tests.jumping.learning.plain_mass import FORWARD_M_S, SCHEDULED_ROWS, STEP_S, PlainJump, plain_jump
from tests.jumping.learning.test_stages import config

BODY: Model = NominalModel(Nominal(A1_BODY, curvature=0.5))


@pytest.fixture(scope="module")
def jumps() -> list[PlainJump]:
    """Four jumps under the same forces, whose rows last differently long."""
    return [plain_jump(f"jump_{i:02d}", seed=i) for i in range(4)]


@pytest.fixture(scope="module")
def claimed(jumps: list[PlainJump], robot: Robot) -> Windows:
    return window_extraction.cut([one.log for one in jumps], TimeGrid(), robot)


@pytest.fixture(scope="module")
def own(jumps: list[PlainJump], robot: Robot) -> Windows:
    return clock_comparison.cut_by_own_clock([one.log for one in jumps], TimeGrid(), robot)


def held_out(cut: Windows, model: Model = BODY) -> HeldOutPredictions:
    """Predictions of all windows by one model that was fitted to none of them."""
    models = {jump: {"nominal_fitted": model} for jump in cut.jumps}
    return HeldOutPredictions(cut, {"nominal_fitted": model.predict(cut.inputs)}, {}, models)


def test_steps_last_as_long_as_they_did(jumps, claimed, own):
    """A row all of whose messages are late is as old as the youngest of them: up to 2 ms."""
    found = clock_comparison.single_steps(own).step_s[:, 0]
    true = np.concatenate([jump.step_s for jump in jumps])
    order = np.lexsort([clock_comparison.single_steps(own).start, clock_comparison.single_steps(own).jump])
    np.testing.assert_allclose(found[order], true, atol=2.01 * STEP_S)
    assert np.median(np.abs(found[order] - true)) < 0.1 * STEP_S
    np.testing.assert_allclose(claimed.step_s, np.where(claimed.contact, 0.025, 0.1), atol=1e-12)
    assert own.step_s[own.contact].max() > 0.035  # stalls
    np.testing.assert_array_equal(own.time_s, claimed.time_s)  # the phase is the schedule's


def test_states_are_those_of_the_instants_and_not_older_ones(jumps, claimed, own):
    """The mass moves forward steadily, so where it is says when it was there."""
    true = np.stack([jump.instants[SCHEDULED_ROWS] for jump in jumps])[
        own.jump[:, None], own.start[:, None] + range(11)
    ]
    by_own = np.cumsum(own.step_s, axis=1)
    scatter = {
        "own": own.state[:, 1:, 0] / FORWARD_M_S - by_own,
        "claimed": claimed.state[:, 1:, 0] / FORWARD_M_S - (true[:, 1:] - true[:, :1]),
    }
    assert np.abs(scatter["own"]).mean() < 0.1 * STEP_S
    assert np.abs(scatter["claimed"]).mean() > 0.4 * STEP_S  # messages are half a millisecond old, and more


def test_a_body_that_nothing_is_wrong_with_errs_by_the_clock_alone(claimed, own):
    error = {}
    for name, cut in (("claimed", claimed), ("own", own)):
        steps = clock_comparison.single_steps(cut)
        error[name] = np.abs(BODY.predict(steps.inputs) - steps.state)[:, 1].mean(axis=0)
    assert error["claimed"][0] > 6e-3 and error["own"][0] < 1e-3  # x: 1.2 m/s for 6 ms more than claimed
    assert error["own"][4] < 0.15 * error["claimed"][4]  # vz, in flight and by unbalanced forces
    assert error["own"][4] < 0.02
    assert error["own"][2] < 1e-9  # nothing turns it


def test_longer_steps_gain_more_where_motion_goes_on_with_time(own):
    gained = clock_comparison.gained_with_time(own)
    assert gained["x"][0] == pytest.approx(1, abs=0.1)
    assert gained["vz"][0] == pytest.approx(1, abs=0.1)
    by_rows = own.state.copy()
    by_rows[..., 4] = 0.1 * (own.start[:, None] + np.arange(11))  # as fast at a row, however late that is
    assert clock_comparison.gained_with_time(replace(own, state=by_rows))["vz"] == pytest.approx((0, 0), abs=1e-9)


def test_the_residual_of_a_body_without_faults_is_the_clock(claimed, own):
    found = clock_comparison.figures(clock_comparison.compare(held_out(claimed), held_out(own)))
    shares = found["residual_that_was_clock"]["nominal_fitted"]
    assert shares["contact"]["x"] > 0.95
    assert shares["first_half_of_flight"]["x"] > 0.95 and shares["first_half_of_flight"]["vz"] > 0.95
    assert found["ten_step_mse"][OWN]["nominal_fitted"] < 0.05 * found["ten_step_mse"][CLAIMED]["nominal_fitted"]
    assert found["jumps_closer_than_claimed"][OWN]["nominal_fitted"]["x"] == 4
    assert found["step_ms"]["contact"]["claimed"] == 25
    assert found["step_ms"]["contact"]["mean"] == pytest.approx(1000 * own.step_s[own.contact].mean(), rel=0.05)


def test_both_clocks_are_judged_at_the_same_place_of_the_world(claimed, own):
    """A prediction that stands still, from the claimed start, is as far off as the world says."""

    class Still(NominalModel):
        def predict(self, inputs):
            return np.repeat(inputs.state[:, None], inputs.step_s.shape[1] + 1, axis=1)

    found = clock_comparison.compare(*(held_out(cut, Still(Nominal(A1_BODY))) for cut in (claimed, own)))
    one = found.windows[CLAIMED]
    error = one.states["nominal_fitted"][..., 0] - one.windows.state[..., 0]
    world = claimed.start_x[:, None] - (own.start_x[:, None] + own.state[..., 0])
    np.testing.assert_allclose(error, world, atol=1e-12)


def test_expected_lengths_of_steps_are_those_of_the_other_jumps(jumps, own):
    expected = clock_comparison.lengths_of_others(own)
    at = np.flatnonzero((own.jump == 2) & (own.start == 20))[0]
    others = np.mean([one.step_s[20:30] for i, one in enumerate(jumps) if i != 2], axis=0)
    np.testing.assert_allclose(expected[at], others, atol=STEP_S)
    assert np.abs(expected[at] - own.step_s[at]).max() > 2 * STEP_S
    assert EXPECTED in clock_comparison.kinds(held_out(own), held_out(own))


def test_an_even_log_has_the_same_windows_by_either_clock(robot, tmp_path):
    log = plain_jump("even", seed=1, uneven=False).log
    assert clock_comparison.uneven_clocks([log], robot.joints) == {}
    windows.write(window_extraction.cut([log], TimeGrid(), robot), tmp_path)
    with np.load(tmp_path / "windows.npz") as archive:
        assert "step_s" not in archive.files  # files of even logs are as they always were
    np.testing.assert_allclose(windows.read(tmp_path).step_s[0], 0.025, atol=1e-12)


def test_windows_by_the_own_clock_are_kept_as_they_are(own, tmp_path):
    windows.write(own, tmp_path)
    back = windows.read(tmp_path)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(back, name), getattr(own, name))
    assert read_json(tmp_path / "windows.json")["note"] == "steps are as long as they were by the logs' own clock"
    with pytest.raises(InputError, match="steps that end before they begin"):
        windows.write(replace(own, step_s=-own.step_s), tmp_path / "backwards")


def test_a_step_without_any_time_is_refused(jumps):
    log, instants = jumps[0].log, jumps[0].instants.copy()
    instants[50:76] = instants[50]
    clock = RowClock(instants, {}, STEP_S, {})
    with pytest.raises(InputError, match="jump_00, rows 50 to 75: found no time that passed, by the log's own clock"):
        clock_comparison.by_own_clock(log, clock, SCHEDULED_ROWS)


def test_windows_of_other_rows_are_not_compared(claimed, own):
    with pytest.raises(InputError, match=r"windows by the own clock: found 81 windows of 3 jumps"):
        clock_comparison.compare(held_out(claimed), held_out(own.of_jumps(own.jumps[1:])))


def test_models_are_trained_and_judged_by_both_clocks(claimed: Windows, own: Windows, tmp_path: Path):
    windows.write(claimed, tmp_path / "windows")
    windows.write(own, tmp_path / "own")
    for changes in ({}, {"train.windows": tmp_path / "own", "train.out": tmp_path / "own_models"}):
        models = {"train.models": ["nominal_fitted", "kernel"], "train.curvature": 0.5, "train.processes": 1}
        train(config(tmp_path, **models, **changes))
    by_both = [
        evaluation.predict_held_out(windows.read(tmp_path / cut), tmp_path / models, "fold")
        for cut, models in (("windows", "models"), ("own", "own_models"))
    ]
    found = clock_comparison.figures(clock_comparison.compare(*by_both))
    assert found["ten_step_mse"]["own"]["nominal_fitted"] < 0.05 * found["ten_step_mse"]["claimed"]["nominal_fitted"]
    assert found["one_step_rms"]["own"]["contact"]["kernel"]["x"] < 1.5e-3 < 6e-3
    assert found["one_step_rms"]["claimed"]["contact"]["nominal_fitted"]["x"] > 6e-3
    assert set(found["coverage"]) == {"claimed", "own"} and "95" in found["coverage"]["own"]["kernel"]


def test_the_mass_moves_as_physics_says(jumps):
    """The recording itself: as far forward as its speed times the true time, and free fall in flight."""
    one = jumps[0]
    assert one.state[-1, 0] - one.state[0, 0] == pytest.approx(FORWARD_M_S * one.instants[-1], rel=1e-9)
    flight = one.instants[1200] - one.instants[800]
    assert one.state[1200, 3] - one.state[800, 3] == pytest.approx(-9.81 * flight, rel=1e-6)
    assert one.instants[-1] > 1.25  # the log claims 1.2 s
