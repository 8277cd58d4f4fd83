"""What imports what in this project, read from the source without running it."""

from functools import cache
from pathlib import Path

from leapgap.import_closure import SourceTree

ROOT = Path(__file__).resolve().parent.parent
TREE = SourceTree((ROOT / "src" / "leapgap", ROOT / "stages"))


def modules() -> dict[str, Path]:
    """Our modules by dotted name."""
    return TREE.modules


def imports(module: str) -> frozenset[str]:
    """Dotted names a module imports, anywhere in its file; ours as modules, others by their first name."""
    return TREE.imports(module)


@cache
def closure(module: str) -> frozenset[str]:
    """All of our modules that a module comes to import, itself included."""
    return frozenset(TREE.closure(module))


def dependency(module: str) -> str:
    """How dvc.yaml names a module: a package of the library as its folder, anything else as its file."""
    parts = module.split(".")
    if parts[0] == "leapgap" and len(parts) >= 2 and modules()[".".join(parts[:2])].name == "__init__.py":
        return f"src/leapgap/{parts[1]}"
    return str(modules()[module].relative_to(ROOT))
