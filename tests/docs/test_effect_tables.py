"""The tables of effects in docs/formats.md and docs/effects.md hold every effect, where it is looked for."""

import re

import pytest

from leapgap import effects
from tests.code import ROOT

FORMATS = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8").split("\n## Effects\n")[1]
LOOKED_FOR, NAMED = FORMATS.split("These are looked for only when they are named")
ROW = re.compile(r"^\| `(\w+)` \| `", re.MULTILINE)


def test_effects_stand_where_they_are_looked_for() -> None:
    """Those that logs with a clock of their own get stand with those that all logs get."""
    usual = {name for name, kind in effects.known().items() if kind.by_default or kind.beside_clock}
    assert sorted(ROW.findall(LOOKED_FOR)) == sorted(usual)
    assert sorted(ROW.findall(NAMED)) == sorted(set(effects.known()) - usual)


@pytest.mark.parametrize("name", effects.known())
def test_every_parameter_of_an_effect_is_named(name: str) -> None:
    rows = re.search(rf"^\| `{name}` \|.*(?:\n\|  ?\|.*)*", FORMATS, re.MULTILINE)
    assert rows
    assert set(effects.known()[name].declarations()) <= set(re.findall(r"`(\w+)`", rows[0]))


def test_how_each_effect_is_simulated_is_told_once() -> None:
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8").split("\n## What shows where\n")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == sorted(effects.known())
