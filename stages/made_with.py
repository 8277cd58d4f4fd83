"""Which code made the figures that `dvc repro` does not make, and whether it has changed since.

Without a word: a line for each file of figures. With files of metrics: note that they were made just now by the code
as it stands, as the targets of the Makefile do; what is noted stands in metrics/made_with.json. Where it was shown that
code that has changed since makes the same figures, ``--unchanged=`` notes how.

Examples:

    python -m stages.made_with
    python -m stages.made_with metrics/blind.json
    python -m stages.made_with "--unchanged=only the message of an error differs" metrics/blind.json
"""

import ast
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from leapgap.errors import InputError, did_you_mean
from leapgap.runtime.atomic_io import read_json, sha256, write_json
from leapgap.runtime.content_hash import digest
from leapgap.runtime.import_closure import SourceTree, digest_of
from stages.common import program, run_command

NOTED = Path("metrics/made_with.json")
KINDS = {".py", ".xml", ".yaml", ".c", ".h"}  # files of these kinds are code
UNCHANGED = "--unchanged="
DIAGNOSIS = "leapgap.diagnosis.diagnose"


def library(*parts: str) -> tuple[str, ...]:
    """Folders of the library as entries of ``CODE``."""
    return tuple(f"src/leapgap/{part}" for part in parts)


KEPT_WHOLE = library("runtime")  # what workers and outputs of a killed stage are kept whole by
BENCH = (DIAGNOSIS, *library("validation"), "conf/withhold", "conf/bench", "stages/bench.py")
CODE: dict[str, tuple[str, ...]] = {
    "metrics/blind.json": (DIAGNOSIS, *library("validation"), "conf/withhold", "conf/size/blind.yaml"),
    "metrics/blind_further.json": (DIAGNOSIS, *library("validation"), "conf/withhold", "conf/size/blind.yaml"),
    "metrics/published/blind.json": (DIAGNOSIS, *library("validation"), "conf/size/blind.yaml"),
    "metrics/bench.json": BENCH,
    "metrics/bench_baseline.json": BENCH,
    "metrics/diagnosis.json": (DIAGNOSIS, "tests/benchmarks/diagnosis_injected.py"),
    "metrics/real/robots.json": (DIAGNOSIS, "leapgap.logs.reading", "conf/robots", "stages/robots.py"),
    "metrics/referee.json": ("leapgap.diagnosis.compare", *library("validation/owners"), "tests/benchmarks/referee.py"),
    "metrics/sensitivity.json": (DIAGNOSIS, "tests/benchmarks/sensitivity.py"),
    "metrics/hostile.json": (*library("logs", "robot", "jumping/control"), *KEPT_WHOLE, "tests/hostile"),
    "metrics/landing_full.json": ("stages.land", "conf/land", "conf/size/full.yaml"),
    "metrics/landing_kicked.json": ("stages.land", "conf/land", "conf/experiment/kicked.yaml"),
    "metrics/landing_paper.json": ("stages.land", "conf/land", "conf/experiment/paper.yaml"),
    "metrics/learning_full.json": ("stages.train", "stages.evaluate", "conf/train", "conf/size/full.yaml"),
    "metrics/published/learning_clocks.json": (*library("jumping/learning"), "tests/benchmarks/clock_comparison.py"),
    "metrics/timing/diagnose.json": (DIAGNOSIS, "tests/benchmarks/diagnose.py"),
    "metrics/timing/sysid.json": (DIAGNOSIS, "tests/benchmarks/sysid.py"),
    "metrics/timing/replay.json": ("leapgap.simulation.replay", "tests/benchmarks/replay.py"),
    "metrics/timing/optimize.json": (*library("jumping/planning", "robot"), "tests/benchmarks/optimize.py"),
    "metrics/timing/train.json": (*library("jumping/learning"), "tests/benchmarks/train.py"),
    "metrics/timing/scale.json": (DIAGNOSIS, *library("jumping/learning"), "tests/benchmarks/scale.py"),
    "metrics/timing/ray_workers.json": ("leapgap.runtime.executor", "leapgap.demo", "tests/benchmarks/ray_workers.py"),
    "metrics/timing/mpc_tick.json": (*library("jumping/control", "jumping/models"), "tests/benchmarks/mpc_tick.py"),
    "metrics/timing/exported_tick.json": (*library("jumping/control"), "tests/benchmarks/exported_tick.py"),
    "metrics/timing/goal_shift_tick.json": (*library("jumping/control"), "tests/benchmarks/goal_shift_tick.py"),
}
"""Code that each file of figures is of: files and folders from the root, and modules with all that they import.
What DVC makes has its own record, ``dvc.lock``."""


def modules(root: Path) -> SourceTree:
    """The modules of the library and of the stages; each is read once."""
    return SourceTree((root / "src/leapgap", root / "stages"))


def files_of(root: Path, code: Sequence[str], tree: SourceTree) -> set[Path]:
    """The files of code of some paths and modules."""
    paths = [root / one for one in code if "/" in one]
    found = {file for path in paths for file in [path, *path.rglob("*")] if file.suffix in KINDS and file.is_file()}
    return found.union(*(tree.files(one) for one in code if "/" not in one))


def fingerprint(root: Path, code: Sequence[str], tree: SourceTree) -> str:
    """SHA-256 over names and meaning of code, as in ``CODE``: comments and docstrings do not count."""
    return digest({file.relative_to(root).as_posix(): hash_of(file) for file in files_of(root, code, tree)})


def hash_of(file: Path) -> str:
    """SHA-256 of the meaning of a module, or of the bytes of another file."""
    return hash_of_module(file.read_bytes()) if file.suffix == ".py" else sha256(file)


@cache
def hash_of_module(code: bytes) -> str:
    """SHA-256 of the meaning of a module; most stand in the closures of many files of figures."""
    return digest_of(ast.parse(code))


def noted(root: Path) -> dict[str, dict[str, Any]]:
    """What is known of each file of figures: ``commit`` that made it, and ``code``, the fingerprint then.

    ``unchanged``, where it is there, says how it was shown that later code makes the same figures; ``code`` is its.
    """
    path = root / NOTED
    return dict(read_json(path)) if path.is_file() else {}


def note(root: Path, names: Sequence[str], unchanged: str = "") -> None:
    """Note that files of figures were made by the code as it stands, or, and how, that it makes them the same."""
    known = noted(root)
    for name in names:
        if name not in CODE:
            do = did_you_mean(name, list(CODE)) or "add it to CODE in stages/made_with.py"
            raise InputError("figures", name, f"one of {', '.join(CODE)}", do)
        if not (root / name).is_file():
            raise InputError(root / name, "no such file", "a file of figures", "make it first")
        if unchanged and name not in known:
            raise InputError(root / name, "no record of its code", "figures of known code", "make it again")
        made = {"commit": known[name]["commit"], "unchanged": unchanged} if unchanged else {"commit": commit(root)}
        known[name] = made | {"code": fingerprint(root, CODE[name], modules(root))}
    write_json(root / NOTED, dict(sorted(known.items())))


def commit(root: Path) -> str:
    """The commit that the working tree is of."""
    command = [program("git"), "-C", str(root), "rev-parse", "--short=10", "HEAD"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(root, "no commit", "a clone of the project", "run it in a clone")
    return done.stdout.strip()


def state(root: Path, name: str, tree: SourceTree) -> str:
    """A word or two on a file of figures: ``absent``, ``unknown`` code, code ``as it stands`` or ``older``.

    Code that is older and makes the same figures is ``unchanged``.
    """
    if not (root / name).is_file():
        return "absent"
    entry = noted(root).get(name)
    if entry is None:
        return "unknown"
    if entry["code"] != fingerprint(root, CODE[name], tree):
        return "older"
    return "unchanged" if "unchanged" in entry else "as it stands"


def table(root: Path) -> list[tuple[str, str, str]]:
    """Name, state and commit of each file of figures."""
    commits, tree = {name: entry["commit"] for name, entry in noted(root).items()}, modules(root)
    return [(name, state(root, name, tree), commits.get(name, "")) for name in CODE]


def files_by_reason(root: Path, unchanged: Sequence[str]) -> dict[str, list[str]]:
    """The files of unchanged figures, by how it was shown that later code makes them the same."""
    found: dict[str, list[str]] = {}
    known = noted(root)
    for name in unchanged:
        found.setdefault(known[name]["unchanged"], []).append(name)
    return found


def markdown(root: Path) -> str:
    """The same as a part of a page of the documentation."""
    rows = table(root)
    reasons = files_by_reason(root, [name for name, says, _ in rows if says == "unchanged"])
    lines = [
        "## Which code made them",
        "",
        "Figures of `dvc repro` are of the code that `dvc.lock` records. Of the others, which take hours, some may be",
        "of older code. `unchanged` is code that is older and was shown to make the same figures:",
        "",
        "| file | its code | commit |",
        "|---|---|---|",
        *(f"| `{name}` | {says} | {commit} |" for name, says, commit in rows),
        "",
        *(f"- {', '.join(f'`{name}`' for name in names)} unchanged: {how}." for how, names in reasons.items()),
    ]
    return "\n".join(lines) + "\n"


def made_with(words: Sequence[str]) -> None:
    """Note files of figures as made by the code as it stands, or as unchanged; print the state of all."""
    reasons = [word.removeprefix(UNCHANGED) for word in words if word.startswith(UNCHANGED)]
    if "" in reasons:
        raise InputError(UNCHANGED, "no reason", "how it was shown that the figures stay", "say it after the sign")
    if names := [word for word in words if not word.startswith(UNCHANGED)]:
        note(Path(), names, "; ".join(reasons))
    for name, says, of in table(Path()):
        print(f"{name:36s} {says:13s} {of}".rstrip())


if __name__ == "__main__":
    run_command("made_with", made_with)
