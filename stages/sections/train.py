"""The section ``train``: data, splits, and settings of their own of each kind of models."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.errors import InputError
from leapgap.jumping.learning.experiment import TrainConfig
from leapgap.jumping.learning.recipe import ModelSettings
from leapgap.jumping.learning.store import settings_by_section
from stages.common import read_config


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
