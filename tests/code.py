"""What imports what in this project, read from the source without running it."""

from functools import cache
from pathlib import Path

from leapgap.runtime.import_closure import SourceTree

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
    """How dvc.yaml names a module: a package of the library, or of the application, as its folder, else the file."""
    parts = module.split(".")
    depth = 3 if parts[:2] == ["leapgap", "jumping"] else 2
    if parts[0] == "leapgap" and len(parts) >= depth and modules()[".".join(parts[:depth])].name == "__init__.py":
        return f"src/{'/'.join(parts[:depth])}"
    return str(modules()[module].relative_to(ROOT))
