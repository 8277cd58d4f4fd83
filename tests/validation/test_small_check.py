"""What the small benchmark of ``dvc repro`` covers: each verdict of a diagnosis."""

import json
from dataclasses import replace

from omegaconf import OmegaConf

from leapgap.robot.model import Robot
from leapgap.validation.case import ChosenCase
from leapgap.validation.case_draw import Half, draw_cases
from stages.common import read_config
from stages.compose import compose_conf
from tests.code import ROOT

VERDICTS = {"named", "partly", "ambiguous", "unknown", "none"}


def chosen(*overrides: str) -> list[ChosenCase]:
    """The cases of a configuration that are not drawn."""
    section = OmegaConf.create(compose_conf(list(overrides))).withhold.chosen
    return [read_config(ChosenCase, own, "withhold.chosen") for own in section]


def test_each_verdict_occurs_in_the_small_check() -> None:
    """A verdict that changes must not leave one uncovered: then another case is to be chosen."""
    found = json.loads((ROOT / "metrics/blind_tiny.json").read_text())
    assert set(found["verdicts"]) == VERDICTS
    assert sum(found["verdicts"].values()) == found["cases"]


def test_chosen_cases_are_shuffled_among_the_drawn_ones_and_change_none(robot: Robot) -> None:
    halves, sizes = {"reported": Half(7202, 2, 0, 0, 1, [])}, {"joint_damping": {"damping": [0.1, 1.0]}}
    own = [replace(one, half="reported").case for one in chosen()]
    drawn, cases = draw_cases(halves, sizes, [], robot), draw_cases(halves, sizes, [], robot, None, own)
    assert len(own) == 2 and {case.seed for case in cases} == {case.seed for case in (*drawn, *own)}
    assert {case.seed for case in drawn} < {case.seed for case in cases}
    assert cases[-2:] != own


def test_no_case_of_the_full_check_is_chosen() -> None:
    assert not chosen("size=blind")
