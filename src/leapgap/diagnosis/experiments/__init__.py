"""Experiments that may tell causes apart: each states what to do in numbers, and plans the logs that it would give.

A class a kind, found in any file of this package.
"""

import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from leapgap.diagnosis.experiments.base import REPEATS, Experiment, Given
from leapgap.logs.log import Log
from leapgap.registry import classes_by_name

ENTRY_POINTS = "leapgap.experiments"  # Group under which other packages offer kinds of experiments


@cache
def known() -> dict[str, type[Experiment]]:
    """All kinds of experiments by name."""
    return classes_by_name(sys.modules[__name__], Experiment, ENTRY_POINTS)  # type: ignore[type-abstract]


def candidates_for(given: Given) -> list[Experiment]:
    """All experiments that are possible, the least effort first."""
    return sorted((one for kind in known().values() for one in kind.candidates(given)), key=lambda one: one.cost)


def experiment_of(settings: Mapping[str, Any]) -> Experiment:
    """The experiment that a report proposes, from its settings."""
    kind = known()[settings["kind"]]
    values = {
        key: tuple(v) if isinstance(v, list) else v for key, v in settings.items() if key not in ("kind", REPEATS)
    }
    return kind(**values)


def plans_of(settings: Mapping[str, Any], given: Given) -> list[Log]:
    """The logs that a report proposes to make: those of the experiment, as many times as it asks for."""
    plans = experiment_of(settings).plans(given) * int(settings.get(REPEATS, 1))
    return [replace(plan, name=f"next_{k}") for k, plan in enumerate(plans)]
