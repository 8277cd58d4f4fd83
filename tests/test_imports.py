"""The direction of imports, which keeps the library readable from the outside in (docs/architecture)."""

import pytest

from tests.code import imports, modules

MAY_IMPORT = {
    "robot": set(),
    "recording": {"robot"},
    "effects": {"robot"},
    "planning": {"robot", "recording"},
    "control": {"robot", "recording"},
    "learning": {"robot", "recording"},
    "simulation": {"robot", "recording", "effects", "control"},
    "diagnosis": {"robot", "recording", "effects", "simulation"},
    "blind": {"robot", "recording", "effects", "simulation", "diagnosis"},  # and no diagnosis imports it
    "experiment": {"robot", "recording", "effects", "planning", "control", "simulation"},
    "view": {"robot", "recording", "learning", "diagnosis", "effects", "simulation"},
}
SHARED = {"registry", "errors", "files", "executor", "cache", "content_hash", "import_closure", "former_results"}
ONLY_IN = {
    "mujoco": {"robot", "effects", "simulation", "diagnosis", "blind"},
    "rerun": {"view"},
    "torch": {"learning"},
    "lightning": {"learning"},
    "onnx": {"learning"},
    "onnxruntime": set(),
    "casadi": {"planning", "control"},
    "daqp": {"control"},
    "osqp": {"control"},
    "hydra": set(),
    "omegaconf": set(),
    "dvc": set(),
}
LIBRARY = [name for name in modules() if name.startswith("leapgap.")]


def package(module: str) -> str:
    return module.split(".")[1]


@pytest.mark.parametrize("module", LIBRARY)
def test_library_imports_only_in_the_stated_direction(module: str) -> None:
    ours = {package(name) for name in imports(module) if name.startswith("leapgap.")}
    allowed = SHARED | {package(module)} | MAY_IMPORT.get(package(module), set())
    assert ours <= allowed, f"{module} imports {ours - allowed}"
    assert not any(name.startswith("stages") for name in imports(module)), f"{module} imports a stage"


@pytest.mark.parametrize("module", LIBRARY)
def test_heavy_libraries_stay_where_they_belong(module: str) -> None:
    misplaced = {lib for lib, homes in ONLY_IN.items() if lib in imports(module) and package(module) not in homes}
    assert not misplaced, f"{module} imports {misplaced}"


def test_every_package_has_a_rule() -> None:
    assert {package(m) for m in LIBRARY if m.count(".") > 1} == set(MAY_IMPORT)
