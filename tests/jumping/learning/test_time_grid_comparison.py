"""Roll-outs from 650 ms on variable and fixed steps, on jumps that obey a known law."""

import numpy as np
import pytest

from leapgap.jumping.learning import evaluation, model_grid, window_extraction
from leapgap.jumping.learning.windows import TimeGrid, Windows
from leapgap.jumping.models.rigid_body import GRAVITY
from tests.jumping.learning.test_training import config


@pytest.fixture(scope="module")
def pair(jumps, windows: Windows, robot, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    fixed = window_extraction.cut(jumps, TimeGrid(0.025, 0.025, 10), robot)
    found = []
    for name, one in (("variable", windows), ("fixed", fixed)):
        model_grid.train(one, config(models=["nominal_fitted", "kernel"]), folder / name)
        found.append(evaluation.predict_held_out(one, folder / name, "fold"))
    return found


def test_a_jump_is_put_together_from_its_windows(pair, jumps):
    windows = pair[1].windows
    inputs, times, states = evaluation.jump_inputs(windows, 2, 26)
    np.testing.assert_allclose(times, 0.65 + 0.025 * np.arange(23))
    rows = np.round(times / jumps[2].info.sample_period_s).astype(int)
    np.testing.assert_allclose(states[:, 1], jumps[2]["base_pos_z"][rows])
    x = jumps[2]["base_pos_x"][rows]
    np.testing.assert_allclose(states[:, 0], x - x[0], atol=1e-12)
    force = window_extraction.total_forces(jumps[2])[rows[:-1]]
    np.testing.assert_allclose(inputs.force[0], np.where(times[:-1, None] < 0.8 - 1e-9, force, 0))


def test_all_end_at_the_landing_and_the_law_of_the_jumps_is_exact_on_its_own_steps(pair):
    found = evaluation.compare(*pair)
    assert set(found) == {
        "measured",
        *(f"{model}/{steps}" for model in ("kernel", "nominal_fitted") for steps in ("variable", "fixed", "fixed_k22")),
    }
    assert all(one.time_s[0] == pytest.approx(0.65) and one.time_s[-1] == pytest.approx(1.2) for one in found.values())
    rms = evaluation.landing_rms(found)
    # the synthetic jumps step by 25/100 ms with fitted gains: that model alone is exact there
    assert rms["z"]["nominal_fitted/variable"] < 1e-9 < 1e-4 < rms["z"]["nominal_fitted/fixed"]


def test_beyond_its_horizon_a_fixed_prediction_falls_freely():
    state = np.array([[1.0, 0.5, 0.1, 2.0, 3.0, -1.0]])
    after = evaluation.ballistic(state, 0.3)
    np.testing.assert_allclose(
        after, [[1.6, 0.5 + 0.9 - GRAVITY * 0.045, -0.2, 2.0, 3.0 - 0.3 * GRAVITY, -1.0]], rtol=1e-12
    )
