"""The page of learned models: whole, self-contained, and the same bytes for the same input."""

import re
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.learning.evaluation import RollOut
from leapgap.jumping.reports import learning

FIGURES = {
    "jumps": 2,
    "windows": 54,
    "cv_mse": {"nominal": 17.5, "kernel": 0.0295},
    "cv_mse_se": {"nominal": 1.2, "kernel": 0.004},
    "forecast_cv_mse": {"kernel": 0.0419},
    "forecast_cv_mse_se": {"kernel": 0.0054},
    "coverage": {"kernel": {"50": 0.51, "80": 0.84, "95": 0.96}},
    "landing_rms": {name: {"kernel/variable": 0.123, "kernel/fixed": 0.456} for name in learning.COMPONENTS},
}
ABOUT = {"jumps": ["a", "b"], "grid": {"steps": 10, "contact_step_s": 0.025, "flight_step_s": 0.1}}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    steps = [f"kernel,{c},{k},{0.01 * k}" for c in learning.COMPONENTS for k in (1, 2)]
    (tmp_path / "error_by_step.csv").write_text("\n".join(["model,component,step,rms", *steps]))
    levels = [f"kernel,all,{p},{p}" for p in (0.5, 0.8, 0.95)]
    (tmp_path / "calibration.csv").write_text("\n".join(["model,component,nominal,observed", *levels]))
    curves = ["fold_0,networks,25,0.5,0.75", "fold_1,networks,25,0.25,0.25", "all,networks,25,9,"]
    (tmp_path / "curves.csv").write_text("\n".join(["split,model,step,train_loss,validation_loss", *curves]))
    return tmp_path


def page(folder: Path) -> str:
    roll_outs = {name: RollOut(np.array([0.65, 1.2]), np.zeros((2, 2, 6))) for name in ("measured", "kernel/variable")}
    return learning.html(FIGURES, {"kernel": 0.013}, ABOUT, folder / "curves.csv", folder, roll_outs)


def test_the_page_shows_every_figure_and_asks_nothing_of_the_net(folder: Path):
    found = page(folder)
    assert found == page(folder)
    for shown in ("17.5 ± 1.2", "0.0295 ± 0.004", "0.0419 ± 0.0054", "51 / 84 / 96", "0.013", "0.123", "0.456"):
        assert shown in found, shown
    assert re.search(r'<(script|link|img)[^>]+(src|href)="', found) is None
    for name in ("errors", "curves", "calibration", "roll_outs"):
        assert f'id="figure-{name}"' in found


def test_curves_are_means_of_the_folds_without_the_final_models(folder: Path):
    figure = learning.learning_curves(learning.read_rows(folder / "curves.csv"))
    assert [list(trace.y) for trace in figure.data] == [[0.375], [0.5]]


def test_without_fixed_steps_and_intervals_the_page_leaves_them_out(folder: Path):
    bare = {name: value for name, value in FIGURES.items() if name != "landing_rms"} | {"coverage": {}}
    found = learning.html(bare, {}, ABOUT, folder / "curves.csv", folder, None)
    assert 'id="figure-roll_outs"' not in found and 'id="figure-calibration"' not in found
