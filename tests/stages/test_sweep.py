"""A multirun ends with one table of what was varied and what came of it."""

import csv
import subprocess
import sys
from pathlib import Path

from leapgap.jumping.learning import windows as windows_module
from tests.jumping.learning.conftest import jumps, windows  # noqa: F401 - fixtures

ROOT = Path(__file__).parents[2]


def test_a_multirun_of_train_ends_with_one_table(windows, tmp_path):  # noqa: F811
    windows_module.write(windows, tmp_path / "windows")
    arguments = [
        "train.models=[kernel]",
        "train.sessions=null",
        "train.folds=2",
        "train.curvature=0",  # as the jumps were made
        f"train.windows={tmp_path / 'windows'}",
        "train.kernel.ridge_contact=10,0.02",
        "train.kernel.length_contact=1,2",
        f"hydra.sweep.dir={tmp_path / 'sweep'}",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "stages.train", "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    with (tmp_path / "sweep" / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 and f"4 runs -> {tmp_path / 'sweep' / 'table.csv'}" in done.stdout
    errors = [float(row["kernel"]) for row in rows]
    assert errors == sorted(errors) and len(set(errors)) == 4
    varied = {(row["train.kernel.ridge_contact"], row["train.kernel.length_contact"]) for row in rows}
    assert varied == {("10", "1"), ("10", "2"), ("0.02", "1"), ("0.02", "2")}
