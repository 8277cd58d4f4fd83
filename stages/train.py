"""Fit every model of the base on every split of the jumps; models that are already fitted are kept.

Examples:

    python -m stages.train train.windows=windows train.out=models
    python -m stages.train -m train.windows=windows train.networks.hidden='[64],[128]'
"""

import time
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.errors import InputError
from leapgap.jumping.learning import evaluation, model_grid, windows
from leapgap.jumping.learning.experiment import TrainConfig
from leapgap.jumping.learning.recipe import ModelSettings
from leapgap.jumping.learning.registry import settings_by_section
from leapgap.runtime.output_folder import claim_folder
from stages.common import in_sweep, output_folder, read_config, run_stage

STAGE = "stages.train"


def train(config: DictConfig) -> dict[str, float] | None:
    """Read windows, write models as <out>/<split>/<model>.npz and .json, and curves.csv.

    In a sweep, the cross-validated errors are returned for its table.
    """
    section = read_train_config(config.train)
    out = output_folder(section.out, STAGE, [section.windows], kept=True)
    data, start = windows.read(Path(section.windows)), time.monotonic()
    claim_folder(out, STAGE)
    fitted = model_grid.train(data, section, out, progress=lambda text: print(text, flush=True))
    if not len(data):
        print(f"no logs: nothing trained -> {out}")
        return None
    print(f"{len(fitted)} models fitted in {time.monotonic() - start:.0f} s, the others kept -> {out}")
    folds = evaluation.predict_held_out(data, out, "fold") if in_sweep() else None
    return None if folds is None else evaluation.cv_figures(folds)


def read_train_config(section: DictConfig) -> TrainConfig:
    """The section ``train``, in it a section of settings for each kind of models that departs from its defaults.

    An unknown key or a value of the wrong type is an ``InputError`` with the full key.
    """
    kinds = settings_by_section()
    values = OmegaConf.to_container(section, resolve=True)
    assert isinstance(values, dict)
    check_keys(values, kinds)
    settings = {
        str(name): read_config(kinds[name], OmegaConf.create(values.pop(name)), f"train.{name}")
        for name in kinds
        if name in values
    }
    return replace(read_config(TrainConfig, OmegaConf.create(values), "train"), model_settings=settings)


def check_keys(values: Mapping[Any, Any], kinds: Mapping[str, type[ModelSettings]]) -> None:
    """Raise ``InputError`` for a key that is neither ``TrainConfig``'s nor a section with some model's settings."""
    own = {field.name for field in fields(TrainConfig)} - {"model_settings"}
    for name in sorted(own & set(kinds)):
        where = f"{kinds[name].__module__}.{kinds[name].__qualname__}"
        raise InputError(where, f"the section {name}", "a name that is no key of train", "choose another")
    for name in values:
        if name not in own | set(kinds):
            expected = f"one of {', '.join(sorted(own | set(kinds)))}"
            raise InputError(f"train.{name}", "no such key", expected, "correct it in conf/ or on the command line")
        if name in kinds and not isinstance(values[name], dict):
            keys = ", ".join(field.name for field in fields(kinds[name]))
            raise InputError(
                f"train.{name}", repr(values[name]), f"a mapping with some of the keys {keys}", "correct it"
            )


if __name__ == "__main__":
    run_stage(train, extensible="train")
