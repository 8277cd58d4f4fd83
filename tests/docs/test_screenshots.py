"""The screenshots of the docs: few, small, of the sizes that the script takes, and each shown on a page."""

from PIL import Image

from tests.code import ROOT
from tests.reports.take_screenshots import SHOTS

FOLDER = ROOT / "docs/screenshots"


def test_screenshots_are_those_of_the_script_and_small() -> None:
    assert {path.name for path in FOLDER.iterdir()} == {f"{name}.png" for name in SHOTS}
    assert len(SHOTS) <= 4
    for name, shot in SHOTS.items():
        path = FOLDER / f"{name}.png"
        assert path.stat().st_size < 400_000
        with Image.open(path) as image:
            assert image.size == shot.size


def test_each_screenshot_is_shown() -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md"))
    assert [name for name in SHOTS if f"screenshots/{name}.png" not in pages] == []


def test_dark_is_dark_and_light_is_light() -> None:
    for name, shot in SHOTS.items():
        with Image.open(FOLDER / f"{name}.png") as image:
            brightness = image.convert("L").resize((1, 1)).getpixel((0, 0))
        assert isinstance(brightness, int)
        assert (brightness < 100) == shot.dark
