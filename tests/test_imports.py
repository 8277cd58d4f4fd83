"""The direction of imports, which keeps the library readable from outside (docs/contributing/architecture.md)."""

import re

import pytest

from tests.code import ROOT, imports, modules

MAY_IMPORT = {
    "runtime": set(),
    "robot": set(),
    "logs": {"robot"},
    "effects": {"robot"},
    "simulation": {"robot", "logs", "effects"},
    "diagnosis": {"robot", "logs", "effects", "simulation"},
    "validation": {"robot", "logs", "effects", "simulation", "diagnosis"},  # and no diagnosis imports it
    "export": {"robot", "effects", "simulation", "diagnosis"},
    "reports": {"robot", "logs", "effects", "simulation", "diagnosis", "validation", "export"},
    "learning": {"robot", "logs", "effects", "simulation", "diagnosis"},
    "jumping": {"robot", "logs", "effects", "simulation"},
    "jumping.reports": {"robot", "logs", "effects", "simulation", "diagnosis", "reports", "jumping"},
}
"""Which packages each package may import, besides itself and the files beside it. Nobody imports ``jumping``."""
FRONT = {"leapgap.__main__", "leapgap.api", "leapgap.cli", "leapgap.demo", "leapgap.settings"}
"""The front door: it may import everything but the application, and only the application's stages import it."""
ONLY_IN = {
    "mujoco": {"robot", "effects", "simulation", "diagnosis", "validation", "export", "jumping"},
    "mujoco_menagerie": {"robot"},
    "rerun": {"reports", "jumping.reports"},
    "torch": {"learning", "jumping.learning"},
    "lightning": {"jumping.learning"},
    "onnx": {"learning", "jumping.learning"},
    "onnxruntime": {"learning"},
    "casadi": {"jumping.planning", "jumping.control"},
    "daqp": {"jumping.control"},
    "osqp": {"jumping.control"},
    "gymnasium": {"simulation"},
    "h5py": {"logs"},
    "rosbags": {"logs"},
    "hydra": set(),
    "omegaconf": set(),
    "dvc": set(),
}
SHARED = {"registry", "errors", "runtime"}
"""Files beside the packages, and the package of processes, caches and outputs, which all of them may use."""
LIBRARY = [name for name in modules() if name.startswith("leapgap.")]


def package(module: str) -> str:
    """``leapgap.jumping.reports.landing`` is of ``jumping.reports``; other packages are one level deep."""
    parts = module.split(".")[1:]
    return ".".join(parts[:2]) if parts[:2] == ["jumping", "reports"] else parts[0]


def part(module: str) -> str:
    """The part of the application, ``jumping.learning``, or the package."""
    parts = module.split(".")[1:]
    return ".".join(parts[:2]) if parts[0] == "jumping" else parts[0]


@pytest.mark.parametrize("module", sorted(set(LIBRARY) - FRONT))
def test_library_imports_only_in_the_stated_direction(module: str) -> None:
    ours = {package(name) for name in imports(module) if name.startswith("leapgap.")}
    allowed = SHARED | {package(module)} | MAY_IMPORT.get(package(module), set())
    assert ours <= allowed, f"{module} imports {ours - allowed}"
    assert not any(name.startswith("stages") for name in imports(module)), f"{module} imports a stage"


@pytest.mark.parametrize("module", LIBRARY)
def test_heavy_libraries_stay_where_they_belong(module: str) -> None:
    misplaced = {
        lib for lib, homes in ONLY_IN.items() if lib in imports(module) and not {package(module), part(module)} & homes
    }
    assert not misplaced, f"{module} imports {misplaced}"


def test_the_front_door_stands_alone_at_the_top() -> None:
    above = {name for name in LIBRARY if name.count(".") == 1 and modules()[name].name != "__init__.py"}
    assert above == FRONT | {"leapgap.errors", "leapgap.registry"}


def test_every_package_has_a_rule() -> None:
    assert {package(m) for m in LIBRARY if m.count(".") > 1} == set(MAY_IMPORT)


GENERIC = sorted(set(MAY_IMPORT) - {"jumping", "jumping.reports"})
A1_NUMBERS = r"12\.453|4\.713|0\.34602|33\.5\b|0\.347\b"
A1_NAMES = r"\b(?:FR|FL|RR|RL)(?:_(?:hip|thigh|calf))?\b|\bUnitree\b|\bA1\b"


@pytest.mark.parametrize("name", GENERIC)
def test_no_generic_package_knows_the_a1(name: str) -> None:
    """Its numbers and the names of its legs are data (conf/robot/a1.yaml); words in comments may name an example."""
    found = []
    for path in sorted((ROOT / "src/leapgap" / name).rglob("*.py")):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if re.search(A1_NUMBERS, line) or re.search(rf"[\"'](?:{A1_NAMES})[\"']", line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not found, "\n".join(found)
