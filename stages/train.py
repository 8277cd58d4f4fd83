"""Fit every model of the base on every split of the jumps; what is there already is kept."""

import time
from pathlib import Path

from omegaconf import DictConfig

from leapgap.learning import experiment
from leapgap.learning.experiment import TrainConfig
from leapgap.recording import windows
from stages.common import output_folder, read_config, run_stage


def train(config: DictConfig) -> None:
    """Read windows, write models as <out>/<split>/<model>.npz and .json, and curves.csv."""
    section = read_config(TrainConfig, config.train, "train")
    out = output_folder(section.out)
    found, began = windows.read(Path(section.windows)), time.monotonic()
    fitted = experiment.train(found, section, out, progress=lambda text: print(text, flush=True))
    if not len(found):
        print(f"no logs: nothing trained -> {out}")
        return
    print(f"{len(fitted)} models fitted in {time.monotonic() - began:.0f} s, the others kept -> {out}")


if __name__ == "__main__":
    run_stage(train)
