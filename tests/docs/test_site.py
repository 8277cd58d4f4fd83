"""The site builds without a warning, loads nothing from a network, and has a page for every package."""

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.code import ROOT, modules

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


def test_no_page_loads_anything_from_a_network(site: Path) -> None:
    loading = [page.name for page in site.rglob("*.html") if LOADED.search(page.read_text(encoding="utf-8"))]
    assert not loading


def test_every_documented_module_stands_on_the_page_of_its_package(site: Path) -> None:
    for name, path in modules().items():
        if name.startswith("leapgap.") and not path.stem.startswith("_"):
            page = site / "api" / f"{name.rpartition('.')[0]}.html"
            assert f'id="{name}"' in page.read_text(encoding="utf-8"), name


def test_front_page_is_the_readme_with_links_that_lead_somewhere(site: Path) -> None:
    page = (site / "index.html").read_text(encoding="utf-8")
    title = re.search(r"^# (.+)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert title
    assert f">{title[1]}<" in page
    assert 'href="docs/' not in page
    assert 'src="docs/' not in page


def test_a_file_that_a_page_includes_stands_in_it(site: Path) -> None:
    """A formatter that puts spaces into the mark leaves the mark on the page."""
    page = (site / "guide" / "quick_start.html").read_text(encoding="utf-8")
    assert "Logs of a small arm, made by plain MuJoCo" in page
    assert not [path.name for path in site.rglob("*.html") if re.search(r"-8 ?&lt; ?-", path.read_text("utf-8"))]
