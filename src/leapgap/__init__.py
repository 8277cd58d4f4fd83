"""Find out why a robot does not move as its MuJoCo simulation does.

    import leapgap as lg

    report = lg.diagnose(lg.read_logs("logs/"), "robot.xml")
    print(report)
    report.save("out/")

Public are the names in ``__all__``. Each is imported when it is first used, so that ``import leapgap`` is fast.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as that of typing, which takes longer to import than all else here
if TYPE_CHECKING:
    from typing import Any

    from leapgap import effects
    from leapgap.api import check, compare, diagnose, judge, read_logs, replay, write_log
    from leapgap.diagnosis.diagnose import Settings
    from leapgap.effects.base import Effect
    from leapgap.errors import InputError
    from leapgap.logs.log import Log
    from leapgap.reports.diagnosis import Report
    from leapgap.robot.model import Robot
    from leapgap.simulation.environment import Environment as Environment
    from leapgap.simulation.simulator import Simulator

    __version__: str

HOMES = {
    "Effect": "leapgap.effects.base",
    "Environment": "leapgap.simulation.environment",
    "InputError": "leapgap.errors",
    "Log": "leapgap.logs.log",
    "Report": "leapgap.reports.diagnosis",
    "Robot": "leapgap.robot.model",
    "Settings": "leapgap.diagnosis.diagnose",
    "Simulator": "leapgap.simulation.simulator",
    "check": "leapgap.api",
    "compare": "leapgap.api",
    "diagnose": "leapgap.api",
    "judge": "leapgap.api",
    "read_logs": "leapgap.api",
    "replay": "leapgap.api",
    "write_log": "leapgap.api",
}
"""Where each public name is defined; ``Environment`` needs the extra ``gym``, and is no part of ``import *``."""

__all__ = [
    "Effect",
    "InputError",
    "Log",
    "Report",
    "Robot",
    "Settings",
    "Simulator",
    "__version__",
    "check",
    "compare",
    "diagnose",
    "effects",
    "judge",
    "read_logs",
    "replay",
    "write_log",
]


def __getattr__(name: str) -> Any:
    """A public name, imported now."""
    if name == "effects":
        return import_module("leapgap.effects")
    if name == "__version__":
        from importlib.metadata import version

        return version("leapgap")
    if name in HOMES:
        return getattr(import_module(HOMES[name]), name)
    raise AttributeError(f"module 'leapgap' has no attribute {name!r}; public are {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted(__all__)
