"""Notebooks run from their first cell to their last, and say what their stored output says, numbers to a tenth.

That of a real robot needs its logs, which are no part of the project: `python -m stages.fetch acrobot`, or a folder
with them in the variable `ACROBOT`.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.code import ROOT
from tests.docs.blocks import Block, check_printed
from tests.project import environment

EXAMPLES = ROOT / "docs" / "examples"
DATA = {"acrobot": Path(os.environ.get("ACROBOT", ROOT / "data" / "raw" / "acrobot"))}
"""Logs of real robots by the notebook and the variable that names their folder, in capitals."""
CAUSE = re.compile(r"^(named|unknown|partly|ambiguous|none)\b.*?\(?(\w+) at (\w+)", re.MULTILINE)


def cells(notebook: Path, kind: str) -> list[dict[str, Any]]:
    """Cells of one kind."""
    found: list[dict[str, Any]] = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in found if cell["cell_type"] == kind]


def printed(notebook: Path) -> str:
    """All that its cells had printed when it was stored."""
    outputs = [output for cell in cells(notebook, "code") for output in cell["outputs"]]
    return "".join("".join(output.get("text", "")) for output in outputs)


@pytest.mark.parametrize("notebook", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs(notebook: Path, tmp_path: Path) -> None:
    """As one script, in a folder with the examples beside it, as its first cell asks for."""
    data = DATA.get(notebook.stem)
    if data and not (data / "sent").is_dir():
        pytest.skip(f"no {data}")
    named = {notebook.stem.upper(): str(data)} if data else {}
    for example in EXAMPLES.glob("*.py"):
        shutil.copy(example, tmp_path)
    program = tmp_path / "cells.py"
    program.write_text("\n\n".join("".join(cell["source"]) for cell in cells(notebook, "code")), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, program],
        cwd=tmp_path,
        env=environment(ROOT) | named,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert CAUSE.findall(done.stdout)
    assert CAUSE.findall(done.stdout) == CAUSE.findall(printed(notebook))
    check_printed(Block(notebook.name, 0, "output", printed(notebook)), done.stdout)


@pytest.mark.parametrize("notebook", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.stem)
def test_links_of_a_notebook_lead_somewhere(notebook: Path) -> None:
    for cell in cells(notebook, "markdown"):
        for target in re.findall(r"\]\(([^)#]+)\)", "".join(cell["source"])):
            assert (notebook.parent / target).exists(), target
