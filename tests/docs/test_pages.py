"""Every block of Python and shell in README.md and docs/ runs, or says why it does not."""

from pathlib import Path

import pytest

from tests.code import ROOT
from tests.docs.blocks import blocks, run_page
from tests.project import environment

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXTS = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in PAGES}
RUNNING = [page for page, text in TEXTS.items() if any(not block.not_run for block in blocks(page, text))]


@pytest.mark.long
@pytest.mark.pipeline
@pytest.mark.parametrize("page", RUNNING)
def test_blocks_of_a_page_run(page: str, folder: Path) -> None:
    run_page(page, TEXTS[page], folder, environment(folder))


@pytest.mark.parametrize("page", TEXTS)
def test_pages_read_whole(page: str) -> None:
    list(blocks(page, TEXTS[page]))  # no fence left open, no mark without its reason or its block
