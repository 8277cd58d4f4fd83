"""The actuators and terms of Isaac Lab 2.3.2 itself, on the processor, without Isaac Sim.

``pip install --no-deps isaaclab==2.3.2`` brings its sources. Its actuators need only torch; what they import besides
(Warp's types, files of a server) is played by empty modules.
"""

import ast
import importlib
import io
import sys
import types
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

VERSION = "2.3.2"


def sources() -> Path:
    """Folder of the package inside what is installed; the test is skipped without it."""
    try:
        installed = version("isaaclab")
    except PackageNotFoundError:
        pytest.skip("no Isaac Lab")
    spec = find_spec("isaaclab")
    if not installed.startswith(VERSION) or spec is None or spec.origin is None:
        pytest.skip(f"Isaac Lab {installed}")
    return Path(spec.origin).parent / "source" / "isaaclab" / "isaaclab"


class Anything(types.ModuleType):
    """A module that has a class of every name."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


def modules(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """Isaac Lab's own ``isaaclab.actuators``, imported for one test."""
    root = sources()
    for name in [name for name in sys.modules if name.partition(".")[0] == "isaaclab"]:
        monkeypatch.delitem(sys.modules, name)
    for name, folder in (("isaaclab", root), ("isaaclab.utils", root / "utils")):
        package = types.ModuleType(name)
        package.__path__ = [str(folder)]
        monkeypatch.setitem(sys.modules, name, package)
    monkeypatch.setitem(sys.modules, "warp", Anything("warp"))
    files = types.ModuleType("isaaclab.utils.assets")
    files.read_file = lambda path: io.BytesIO(Path(path).read_bytes())  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, files.__name__, files)
    utils = sys.modules["isaaclab.utils"]
    for part, name in (
        ("configclass", "configclass"),
        ("buffers", "DelayBuffer"),
        ("interpolation", "LinearInterpolation"),
    ):
        setattr(utils, name, getattr(importlib.import_module(f"isaaclab.utils.{part}"), name))
    return importlib.import_module("isaaclab.actuators")


def arguments(file: str, name: str) -> set[str]:
    """Arguments of a function in a file of Isaac Lab, or of the call of a class of terms."""
    for node in ast.parse((sources() / file).read_text()).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return {one.arg for one in node.args.args}
        if isinstance(node, ast.ClassDef) and node.name == name:
            (call,) = [one for one in node.body if isinstance(one, ast.FunctionDef) and one.name == "__call__"]
            return {one.arg for one in call.args.args} - {"self"}
    raise AssertionError(f"{file} has no {name}")


def methods(file: str, name: str, of: str) -> set[str]:
    """Arguments of a method of a class in a file of Isaac Lab."""
    (found,) = [one for one in ast.parse((sources() / file).read_text()).body if getattr(one, "name", "") == of]
    assert isinstance(found, ast.ClassDef)
    (method,) = [one for one in found.body if getattr(one, "name", "") == name]
    assert isinstance(method, ast.FunctionDef)
    return {one.arg for one in method.args.args} - {"self"}


def fields(file: str, name: str) -> set[str]:
    """Fields of a configuration in a file of Isaac Lab, without those of its bases."""
    (found,) = [one for one in ast.parse((sources() / file).read_text()).body if getattr(one, "name", "") == name]
    assert isinstance(found, ast.ClassDef)
    return {one.target.id for one in found.body if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)}
