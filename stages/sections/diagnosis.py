"""The settings of a diagnosis whose answer is judged."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.diagnosis.settings import Settings
from stages.common import read_config


def diagnosis_settings(config: DictConfig, overrides: Mapping[str, Any]) -> Settings:
    """The settings of stage ``diagnose`` with overrides, without a best simulator: answers are judged."""
    merged = OmegaConf.merge(config.diagnose.settings, overrides)
    return replace(read_config(Settings, merged, "diagnose_withheld.settings"), best=False)
