"""The pictures of effects: one of each, on the page, small, and with the silence that physics asks for."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from docs.effect_signatures import moderate_effects
from leapgap.robot.model import Robot
from tests.code import ROOT

FOLDER = ROOT / "docs/research/signatures"
PICTURES = sorted(FOLDER.glob("*.svg"))
SVG = "{http://www.w3.org/2000/svg}"


def labels(path: Path) -> list[str]:
    """What stands above the panels: channel and scale, or ``nothing``."""
    return [text.text or "" for text in ElementTree.parse(path).iter(f"{SVG}text")][:-1]


def lines(path: Path) -> list[list[float]]:
    """Heights of each panel's line over its zero, pixels, upward."""
    found = ElementTree.parse(path).iter(f"{SVG}polyline")
    return [[50.0 - float(point.split(",")[1]) for point in line.attrib["points"].split()] for line in found]


def test_every_effect_has_its_picture_and_no_other_is_kept() -> None:
    names = {label.replace(": ", "_") for label in moderate_effects(Robot.load())}
    assert {path.stem for path in PICTURES} == names


def test_the_page_shows_every_picture_once() -> None:
    shown = re.findall(r"\(signatures/([\w.]+)\)", (ROOT / "docs/research/signatures.md").read_text(encoding="utf-8"))
    assert sorted(shown) == [path.name for path in PICTURES]


def test_pictures_are_small_and_load_nothing() -> None:
    assert sum(path.stat().st_size for path in PICTURES) < 10_000 * len(PICTURES)
    for path in PICTURES:
        assert not re.search(r"<image|<script|href|url\(", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.stem)
def test_a_picture_has_four_panels_and_a_line_in_each_that_is_not_nothing(path: Path) -> None:
    assert len(labels(path)) == len(lines(path)) == 4
    for label, line in zip(labels(path), lines(path), strict=True):
        assert label.endswith(": nothing") == (max(map(abs, line)) == 0)


@pytest.mark.parametrize("name", ["state_latency", "aerodynamic_drag"])
def test_what_acts_on_the_base_alone_leaves_the_knee_alone(name: str) -> None:
    """Late readings of the base change no joint of a replay, and the legs have no drag."""
    assert [label.endswith(": nothing") for label in labels(FOLDER / f"{name}.svg")[:2]] == [True, True]


@pytest.mark.parametrize("name", ["command_delay", "motor_lag", "torque_speed_limit", "foot_friction"])
def test_what_needs_force_or_speed_shows_little_before_the_push_off(name: str) -> None:
    """In the first tenth of the time the robot begins to squat: slowly, with steady forces, and no foot slips."""
    for line in lines(FOLDER / f"{name}.svg"):
        assert max(map(abs, line[: len(line) // 10])) < 0.25 * max(map(abs, line))


@pytest.mark.parametrize("name", ["encoder_bias", "ground_height"])
def test_what_is_there_at_rest_shows_from_the_first_moment(name: str) -> None:
    line = lines(FOLDER / f"{name}.svg")[1]  # the speed of the knee
    assert max(map(abs, line[: len(line) // 10])) > 0.5 * max(map(abs, line))
