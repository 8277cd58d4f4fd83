"""The site builds without a warning, loads nothing from a network, and its generated pages hold what the code has."""

import dataclasses
import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from leapgap import cli
from leapgap.diagnosis.settings import Settings
from tests.code import ROOT

pytestmark = [
    pytest.mark.skipif(not find_spec("mkdocs"), reason="no mkdocs: pip install -e '.[docs]'"),
    pytest.mark.long,
]
LOADED = re.compile(r"<(?:script|img|iframe)[^>]*\ssrc=[\"']?(https?:)?//|<link[^>]*\shref=[\"']?(https?:)?//")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-q", "--strict", "-d", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def test_no_page_loads_anything_from_a_network(site: Path) -> None:
    assert not [page.name for page in site.rglob("*.html") if LOADED.search(text_of(page))]


def test_front_page_is_the_readme_with_links_that_lead_somewhere(site: Path) -> None:
    page = text_of(site / "index.html")
    title = re.search(r"^# (.+)$", text_of(ROOT / "README.md"), re.MULTILINE)
    assert title
    assert f">{title[1]}<" in page
    assert 'href="docs/' not in page
    assert 'src="docs/' not in page


def test_every_command_option_and_setting_stands_in_the_reference(site: Path) -> None:
    command = text_of(site / "reference" / "command.html")
    for name, parser in cli.parser()._subparsers._group_actions[0].choices.items():  # type: ignore[union-attr]
        assert f"leapgap {name}" in command
        assert all(option in command for option in parser._option_string_actions)
    settings = text_of(site / "reference" / "settings.html")
    assert all(f"<code>{one.name}</code>" in settings for one in dataclasses.fields(Settings))


def test_the_search_works_from_files_and_leaves_the_research_record_out(site: Path) -> None:
    index = text_of(site / "search" / "search_index.js")
    assert index.startswith("var __index = ")
    found = {entry["location"].partition("#")[0] for entry in json.loads(index.removeprefix("var __index = "))["docs"]}
    assert {"tutorials/arm.html", "explanation/diagnosis.html", "reference/effects.html"} <= found
    assert not [page for page in found if page.startswith(("research/", "contributing/"))]
    assert "iframe-worker.js" in text_of(site / "index.html")
