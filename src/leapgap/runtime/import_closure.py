"""Import closures: the files that a module depends on, read from import statements without running them.

Code counts by its meaning: comments, docstrings, blank lines and layout change no hash.
"""

import ast
import hashlib
import json
import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import packages_distributions, version
from pathlib import Path

PACKAGE = Path(__file__).parent.parent  # folder of the installed library
DATA = (".xml", ".html")  # endings of the files beside modules that modules read

LOADER = "classes_by_name"  # the function that imports all modules of a package; its callers depend on them


@dataclass(frozen=True)
class ModuleReading:
    """What the file of a module says, from one parse: syntax trees of all modules would fill the memory."""

    imports: frozenset[str]  # modules of the tree and outermost packages of others (``SourceTree.imports``)
    data_names: frozenset[str]  # string literals that end like a data file
    meaning: str  # SHA-256 of what the code says (``meaning``)


@dataclass(frozen=True)
class SourceTree:
    """The modules below some package folders, and what they import."""

    packages: tuple[Path, ...]  # folders of top-level packages; dotted names begin with the folder's name

    @cached_property
    def modules(self) -> dict[str, Path]:
        """Files of the modules by dotted name."""
        found = {}
        for package in self.packages:
            for path in sorted(package.rglob("*.py")):
                parts = path.relative_to(package.parent).with_suffix("").parts
                found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
        return found

    @cached_property
    def _readings(self) -> dict[str, ModuleReading]:
        return {}

    def imports(self, module: str) -> frozenset[str]:
        """Names that a module imports anywhere in its file: modules of this tree in full, others by their first part.

        The packages around an imported module count, since importing it runs them. The outermost package counts only
        where something of its own is imported: it may offer every other package without depending on them.
        """
        return self._read(module).imports

    def _read(self, module: str) -> ModuleReading:
        """The reading of a module, whose file is parsed once."""
        if module not in self._readings:
            tree = ast.parse(self.modules[module].read_bytes())
            names = list(self._names(module, tree))
            found: set[str] = set()
            for name in names:
                first = name.split(".")[0]
                if first not in {package.name for package in self.packages}:
                    found.add(first)
                elif name in self.modules:
                    parts = name.split(".")
                    found |= {name, *{".".join(parts[:i]) for i in range(2, len(parts))}} & set(self.modules)
            imports = frozenset(found | self._loaded_by_name(module, tree, names))
            self._readings[module] = ModuleReading(imports, data_names(tree), digest_of(tree))
        return self._readings[module]

    def _names(self, module: str, tree: ast.Module) -> Iterator[str]:
        """Dotted names in the import statements of a module."""
        for node in executed_nodes(tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = self._base(module, node)
                members = [f"{base}.{alias.name}" for alias in node.names]
                yield from members
                if "." in base or not all(member in self.modules for member in members):
                    yield base
            elif isinstance(node, ast.Call) and call_name(node) == "import_module" and is_text(node.args):
                yield node.args[0].value  # type: ignore[attr-defined]

    def _base(self, module: str, node: ast.ImportFrom) -> str:
        """The module of a ``from … import`` statement, with leading dots resolved."""
        if node.level == 0:
            return node.module or ""
        is_package = self.modules[module].name == "__init__.py"
        parts = module.split(".")[: None if is_package else -1]
        parts = parts[: len(parts) - node.level + 1]
        return ".".join([*parts, *([node.module] if node.module else [])])

    def _loaded_by_name(self, module: str, tree: ast.Module, names: list[str]) -> set[str]:
        """All modules of a package that finds them by their file names (pkgutil, or a computed ``import_module``).

        ``names`` are those in the module's import statements.
        """
        if any(isinstance(node, ast.FunctionDef) and node.name == LOADER for node in tree.body):
            return set()  # it loads packages of its callers
        own = module if self.modules[module].name == "__init__.py" else module.rpartition(".")[0]
        packages = {own} if "pkgutil" in names else set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and call_name(node) == LOADER:
                packages.add(self._named(names, node.args[0]) or own)
            elif isinstance(node, ast.Call) and call_name(node) == "import_module" and not is_text(node.args):
                packages.add(own)
        return {name for name in self.modules for package in packages if name.startswith(f"{package}.")} - {module}

    def _named(self, names: list[str], argument: ast.expr) -> str | None:
        """The package of this tree that an argument names, where it is among the imported ``names``; else None."""
        if not isinstance(argument, ast.Name):
            return None
        return next((n for n in names if n.rpartition(".")[2] == argument.id and n in self.modules), None)

    def closure(self, *roots: str, without: Collection[str] = ()) -> set[str]:
        """All modules of this tree that the root modules import, directly or indirectly, and the roots.

        ``without``: modules that are not followed, since nothing of them is used.
        """
        seen: set[str] = set()
        queue = set(roots)
        while queue:
            module = queue.pop()
            seen.add(module)
            queue |= {name for name in self.imports(module) if name in self.modules} - seen - set(without)
        return seen

    def data_files(self, module: str) -> list[Path]:
        """Data files beside a module that its string literals name, such as the template of a page."""
        if not (named := self._read(module).data_names):
            return []
        beside = sorted(self.modules[module].parent.iterdir())
        return [path for path in beside if path.suffix in DATA and path.name in named]

    def files(self, *roots: str) -> list[Path]:
        """The files of a closure: modules and the data they read, sorted."""
        closure = self.closure(*roots)
        return sorted({path for name in closure for path in (self.modules[name], *self.data_files(name))})

    def hashes(self, *roots: str, without: Collection[str] = ()) -> dict[str, str]:
        """SHA-256 of the meaning of every module of a closure, by its dotted name, and of the data files, by path."""
        found = {}
        for module in sorted(self.closure(*roots, without=without)):
            found[module] = self._read(module).meaning
            for path in self.data_files(module):
                (package,) = (package for package in self.packages if path.is_relative_to(package))
                found[path.relative_to(package.parent).as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest()
        return dict(sorted(found.items()))

    def libraries(self, *roots: str) -> dict[str, str]:
        """Versions of the installed distributions that a closure imports, by name."""
        imported = {name for module in self.closure(*roots) for name in self.imports(module)}
        others = imported - set(self.modules) - sys.stdlib_module_names
        found = {name: version(name) for other in others for name in distributions().get(other, ())}
        return dict(sorted((found | {other: "absent" for other in others if other not in distributions()}).items()))

    def code_hash(self, *roots: str) -> str:
        """SHA-256 of the meaning of all code of a closure, and of the versions of the libraries it imports."""
        return hashlib.sha256(json.dumps([self.libraries(*roots), self.hashes(*roots)]).encode()).hexdigest()


def data_names(tree: ast.Module) -> frozenset[str]:
    """String literals of a module that end like a data file."""
    values = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return frozenset(value for value in values if isinstance(value, str) and value.endswith(DATA))


def call_name(node: ast.Call) -> str:
    """Last name of the called function: ``import_module`` of ``importlib.import_module(…)``."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def is_text(arguments: list[ast.expr]) -> bool:
    """Whether the first argument of a call is a literal text."""
    return bool(arguments) and isinstance(arguments[0], ast.Constant) and isinstance(arguments[0].value, str)


@cache
def distributions() -> dict[str, list[str]]:
    """Installed distributions by the names they are imported by."""
    return {name: list(found) for name, found in packages_distributions().items()}


@cache
def library(package: Path) -> SourceTree:
    """The modules of a copy of this library; read once, so that a key does not change while a run is under way."""
    return SourceTree((package,))


@cache
def hash_of(package: Path, roots: tuple[str, ...]) -> str:
    """``code_hash`` of modules of a copy of this library."""
    return library(package).code_hash(*roots)


def code_hash(*roots: str) -> str:
    """SHA-256 of all code of this library that some of its modules depend on, and of their libraries' versions."""
    return hash_of(PACKAGE, tuple(sorted(set(roots))))


def executed_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a module without those under ``if TYPE_CHECKING``, which never run."""
    queue = [tree]
    while queue:
        node = queue.pop()
        yield node
        children = list(ast.iter_child_nodes(node))
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            children = list(node.orelse)
        queue += children


def meaning(value: object) -> str:
    """A text that is the same for two syntax trees whenever they do the same: without comments and docstrings.

    Neither are imports for type checkers in it, nor empty fields, which differ between versions of Python.
    """
    if isinstance(value, ast.JoinedStr):  # Python 3.12 puts empty texts into some
        return f"JoinedStr({','.join(one for one in map(meaning, value.values) if one != EMPTY_TEXT)})"
    if isinstance(value, ast.AST):
        fields = ((name, one) for name, one in ast.iter_fields(value) if name not in LAYOUT and one not in (None, []))
        return f"{type(value).__name__}({','.join(f'{name}={meaning(one)}' for name, one in fields)})"
    if isinstance(value, list):
        return f"[{','.join(meaning(one) for one in value if not is_silent(one))}]"
    return repr(value)


def digest_of(tree: ast.Module) -> str:
    """SHA-256 of what a module does."""
    return hashlib.sha256(meaning(tree).encode()).hexdigest()


EMPTY_TEXT = "Constant(value='')"
LAYOUT = ("kind", "type_comment", "ctx")  # fields of a syntax tree that say how something is written, or where


def is_silent(node: object) -> bool:
    """Whether a statement does nothing: a docstring, also one below an attribute, or an import for type checkers."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test) and not node.orelse
