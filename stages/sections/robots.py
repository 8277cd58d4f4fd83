"""The section ``robots``: logs of real robots, and how each is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.logs.importers import log_format
from leapgap.logs.importers.base import LogFormat
from leapgap.validation.real_robots import RealCase, absent
from stages.common import CONF, read_config, read_each


@dataclass(frozen=True)
class RobotsSettings:
    """Section ``robots`` of the configuration."""

    raw: str
    out: str | None
    metrics: str | None
    cases: dict[str, Any]
    """Name of a case → its ``RealCase``, read one by one so that a wrong key is told with its case."""
    pushes: dict[str, dict[str, str]]
    """Name of a case → joint → column of its tables with the torque that pushed it, hidden from the diagnosis."""


def cases_here(config: DictConfig, raw: Path) -> dict[str, RealCase]:
    """The cases whose files are there, by name; the others are said."""
    here = {}
    for name, case in read_each(RealCase, config.robots.cases, "robots.cases").items():
        why = absent(case, raw)
        if why is None:
            here[name] = case
        else:
            print(f"{name}: left out: {why}")
    return here


def importer(name: str) -> tuple[LogFormat, Any]:
    """Format and options of an import, by the name of its file in conf/import_logs."""
    settings: Any = OmegaConf.load(CONF / "import_logs" / f"{name}.yaml")
    layout = log_format(settings.format)
    return layout, read_config(layout.Options, settings[settings.format], f"import_logs.{settings.format}")
