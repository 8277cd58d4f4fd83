"""The Makefile takes a Python that runs and fits, whatever the names on the path promise."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.code import ROOT

TOOLS = ("sh", "make", "find", "touch", "mkdir", "chmod")


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
    assert "expected Python 3.11 to 3.14" in done.stderr
    assert not (tmp_path / ".venv").exists()


def test_a_named_python_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    done = make(tmp_path, ".venv/ready", "PYTHON=python3", python3="exit 1")
    assert done.returncode != 0
    assert "found python3;" in done.stderr


@pytest.mark.parametrize("name", ["python3.12", "python3.13", "python"])
def test_any_name_of_a_python_that_fits_does(tmp_path: Path, name: str) -> None:
    done = make(tmp_path, "-n", ".venv/ready", **{"python3.11": "exit 1", name: "exit 0"})
    assert f"{tmp_path}/bin/{name} -m venv .venv" in done.stdout


def test_uv_brings_a_python_where_none_fits(tmp_path: Path) -> None:
    done = make(tmp_path, "-n", ".venv/ready", python3="exit 1", uv="exit 0")
    assert f"{tmp_path}/bin/uv venv -q --seed --python '>=3.11,<3.15' .venv" in done.stdout


def test_a_debian_python_that_lacks_venv_is_named_with_what_to_install(tmp_path: Path) -> None:
    """Such a Python runs, but has no ensurepip; here it is hidden from the real one."""
    hide = "import importlib.util as u; f = u.find_spec; u.find_spec = lambda n: None if n == 'ensurepip' else f(n)"
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(f"import sys; sys.modules['ensurepip'] = None\n{hide}\n")
    version = "{}.{}".format(*sys.version_info[:2])
    done = make(tmp_path, ".venv/ready", python3=f'PYTHONPATH={site} exec {sys.executable} "$@"')
    assert done.returncode != 0
    assert f"is Python {version} without ensurepip: apt-get install python3-venv" in done.stderr
    assert "found neither python3.11 nor another python3 that fits" in done.stderr
    assert not (tmp_path / ".venv").exists()


def test_the_demo_needs_the_instrument_and_no_pipeline(tmp_path: Path) -> None:
    done = make(tmp_path, "-n", "demo", **{"python3.11": "exit 0"})
    assert '-e ".[view]"' in done.stdout and ".[dev]" not in done.stdout
    assert "leapgap demo --number 3 --out data/demo --no-browser" in done.stdout.splitlines()


def test_the_demo_runs_in_the_full_environment_where_there_is_one(tmp_path: Path) -> None:
    """What stands on the disk is this: an environment that is newer than pyproject.toml, with a command leapgap."""
    python = (
        "mkdir -p .venv/bin; printf '#!/bin/sh\\necho \"demo: $@\"' > .venv/bin/leapgap; chmod +x .venv/bin/leapgap"
    )
    pip = "printf '#!/bin/sh\\nexit 0' > .venv/bin/pip; chmod +x .venv/bin/pip"
    environment = {"python3.11": f'if [ "$1" = -m ]; then {python}; {pip}; fi'}
    assert make(tmp_path, ".venv/ready", **environment).returncode == 0
    shutil.rmtree(tmp_path / "bin")
    done = make(tmp_path, "demo", "NUMBER=5", **environment)
    assert "demo: demo --number 5 --out data/demo --no-browser" in done.stdout, done.stdout + done.stderr
    assert not (tmp_path / ".venv/demo_ready").exists()


def test_continuous_integration_runs_the_long_tests_too() -> None:
    """``make test`` leaves them out."""
    rules = (ROOT / "Makefile").read_text(encoding="utf-8")
    everything = rules[rules.index("\ntest-all: .venv/ready") :].splitlines()[2]
    assert "pytest" in everything
    assert "-m" not in everything.split()
    assert "make test-all" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
