"""Ctrl-C while the command still imports, with a module in place of a real one that takes long to import."""

import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.code import ROOT

SLOW = """import time
from pathlib import Path
Path({marker!r}).touch()
time.sleep({seconds})
"""


def entry_point() -> str:
    """What the installed script runs, as Python code."""
    module, function = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["leapgap"].split(":")
    return f"import sys; from {module} import {function}; sys.exit({function}())"


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    """Wait until a file is there; fail where the process ends before."""
    while not path.exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


def interrupted(
    start: tuple[str, str], heavy: str, tmp_path: Path, handler: Any, seconds: int = 60
) -> tuple[int, str, str]:
    """Exit code, output and messages of a command that is sent Ctrl-C while it imports a module for some seconds."""
    marker = tmp_path / "imports"
    (tmp_path / f"{heavy}.py").write_text(SLOW.format(marker=str(marker), seconds=seconds))
    process = subprocess.Popen(
        [sys.executable, *start, "effects"],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT / 'src'}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, handler),
    )
    try:
        wait_for(marker, process)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    finally:
        process.kill()
    return process.returncode, out, err


@pytest.mark.parametrize("heavy", ["argparse", "numpy", "mujoco"])
@pytest.mark.parametrize("start", [("-c", entry_point()), ("-m", "leapgap")])
def test_ctrl_c_while_a_module_is_imported_is_one_line(heavy: str, start: tuple[str, str], tmp_path: Path) -> None:
    """One that the command needs to read its arguments, and two that come later."""
    said = interrupted(start, heavy, tmp_path, signal.default_int_handler)
    assert said == (130, "", "leapgap: stopped by Ctrl-C; nothing was written\n")


def test_a_command_that_ignores_ctrl_c_goes_on(tmp_path: Path) -> None:
    """As one that a script has started in the background."""
    code, _, err = interrupted(("-c", entry_point()), "argparse", tmp_path, signal.SIG_IGN, seconds=1)
    assert "AttributeError" in err  # it goes on, and ends since the module in place of argparse is empty
    assert code == 1
