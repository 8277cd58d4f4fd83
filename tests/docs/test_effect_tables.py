"""The tables of effects hold every effect: the one of the site, made from the code, and docs/research/effects.md."""

import re

import pytest

from leapgap import effects
from tests.code import ROOT
from tests.docs.hook import HOOK


@pytest.mark.parametrize("name", effects.known())
def test_every_effect_has_its_parameters_and_when_it_is_looked_for(name: str) -> None:
    kind = effects.known()[name]
    rows = re.search(rf"^\| `{name}`.*(?:\n\|  \|.*)*", HOOK["effects_page"](), re.MULTILINE)
    assert rows
    assert set(kind.declarations()) <= set(re.findall(r"`(\w+)`", rows[0]))
    assert effects.describe(kind).lower() in rows[0].lower()
    assert (" default |" in rows[0]) == kind.by_default


def test_how_each_effect_is_simulated_is_told_once() -> None:
    page = (ROOT / "docs" / "research" / "effects.md").read_text(encoding="utf-8").split("\n## What shows where\n")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == sorted(effects.known())
