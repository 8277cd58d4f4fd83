"""The Makefile takes a Python that runs and fits, whatever the names on the path promise."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.code import ROOT

TOOLS = ("sh", "make", "find")


def script(path: Path, text: str) -> None:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def make(tmp_path: Path, *arguments: str, **pythons: str) -> subprocess.CompletedProcess[str]:
    """``make -n lint`` in an empty project, where nothing but ``pythons`` (name: shell script) is on the path."""
    commands = tmp_path / "bin"
    commands.mkdir()
    for tool in TOOLS:
        (commands / tool).symlink_to(shutil.which(tool) or pytest.skip(f"no {tool}"))
    for name, text in pythons.items():
        script(commands / name, text)
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path / name)
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHON", "MAKEFLAGS", "MAKELEVEL")}
    return subprocess.run(
        ["make", *arguments], cwd=tmp_path, env=environment | {"PATH": str(commands)}, capture_output=True, text=True
    )


def test_a_name_that_does_not_run_is_passed_over(tmp_path: Path) -> None:
    done = make(tmp_path, "-n", ".venv/ready", **{"python3.11": "exit 127", "python3": "exit 0"})
    assert f"{tmp_path}/bin/python3 -m venv .venv" in done.stdout


def test_python_3_11_comes_first(tmp_path: Path) -> None:
    done = make(tmp_path, "-n", ".venv/ready", **{"python3.11": "exit 0", "python3": "exit 0"})
    assert f"{tmp_path}/bin/python3.11 -m venv .venv" in done.stdout


def test_without_a_python_that_fits_the_message_says_so(tmp_path: Path) -> None:
    done = make(tmp_path, ".venv/ready", python3="exit 1")
    assert done.returncode != 0
    assert "found neither python3.11 nor another python3" in done.stderr
    assert "expected Python 3.11, 3.12 or 3.13" in done.stderr
    assert not (tmp_path / ".venv").exists()


def test_a_named_python_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    done = make(tmp_path, ".venv/ready", "PYTHON=python3", python3="exit 1")
    assert done.returncode != 0
    assert "found python3;" in done.stderr
