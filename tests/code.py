"""What imports what, read from the source without running it."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@cache
def modules() -> dict[str, Path]:
    """Our modules by dotted name."""
    found = {}
    for base, top in ((ROOT / "src", "leapgap"), (ROOT, "stages")):
        for path in sorted((base / top).rglob("*.py")):
            parts = path.relative_to(base).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports(module: str) -> frozenset[str]:
    """Dotted names a module imports, anywhere in its file; ours as modules, others by their first name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(modules()[module].read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            names = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            first = name.split(".")[0]
            if first not in ("leapgap", "stages"):
                found.add(first)
            elif name in modules():
                found.add(name)
                # importing a.b.c runs a and a.b too
                found.update(
                    parent for i in range(1, name.count(".") + 1) if (parent := name.rsplit(".", i)[0]) in modules()
                )
    found |= loaded_by_name(module)
    return frozenset(found)


def loaded_by_name(module: str) -> set[str]:
    """A package that finds its modules by their file names (pkgutil) imports them all."""
    if "pkgutil" not in modules()[module].read_text(encoding="utf-8"):
        return set()
    return {name for name in modules() if name.startswith(f"{module}.")}


def closure(module: str) -> set[str]:
    """All of our modules that a module comes to import, itself included."""
    seen, open_ = set(), {module}
    while open_:
        one = open_.pop()
        seen.add(one)
        open_ |= {name for name in imports(one) if name in modules()} - seen
    return seen


def dependency(module: str) -> str:
    """How dvc.yaml names a module: a package of the library as its folder, anything else as its file."""
    parts = module.split(".")
    if parts[0] == "leapgap" and len(parts) >= 2 and modules()[".".join(parts[:2])].name == "__init__.py":
        return f"src/leapgap/{parts[1]}"
    return str(modules()[module].relative_to(ROOT))
