"""Fit every model of the base on every split of the jumps; models that are already fitted are kept.

Examples:

    python -m stages.train train.windows=windows train.out=models
    python -m stages.train -m train.windows=windows train.networks.hidden='[64],[128]'
"""

import time
from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from leapgap.jumping.learning import evaluation, model_grid, windows
from leapgap.runtime.output_folder import claim_folder
from stages.common import in_sweep, output_folder, run_stage
from stages.sections.train import read_train_config

STAGE = "stages.train"


def train(config: DictConfig) -> dict[str, float] | None:
    """Write models as <out>/<split>/<model>.npz and .json, and curves.csv; in a sweep, return their errors."""
    section = read_train_config(config.train)
    out = output_folder(section.out, STAGE, [section.windows], kept=True)
    data, start = windows.read(Path(section.windows)), time.monotonic()
    claim_folder(out, STAGE)
    fitted = model_grid.train(data, section, out, partial(print, flush=True))
    if not len(data):
        print(f"no logs: nothing trained -> {out}")
        return None
    print(f"{len(fitted)} models fitted in {time.monotonic() - start:.0f} s, the others kept -> {out}")
    folds = evaluation.predict_held_out(data, out, "fold") if in_sweep() else None
    return None if folds is None else evaluation.cv_figures(folds)


if __name__ == "__main__":
    run_stage(train, extensible="train")
