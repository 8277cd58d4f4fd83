"""A result is kept as long as nothing it was made from changes, and nothing that is not ours is removed."""

import ast
import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from leapgap import effects
from leapgap.jumping.experiments.identification import identify_effects_config
from leapgap.jumping.experiments.trial import TrialSpec
from leapgap.jumping.learning.experiment import fit_task
from leapgap.jumping.learning.store import export_model
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.reports.diagnosis import diagnose_folder
from leapgap.robot.model import Robot
from leapgap.runtime import import_closure
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.runtime.content_hash import digest, modules_within
from leapgap.runtime.import_closure import DATA, PACKAGE, SourceTree, code_hash
from leapgap.runtime.output_folder import claim_folder
from leapgap.validation.case import further_jumps
from stages.code import RENDERS, hashes
from tests.code import ROOT, TREE, closure, dependency
from tests.conftest import standing
from tests.test_pipeline_files import stages, word


@dataclass(frozen=True)
class Pair:
    first: float = 1.0
    second: float = 2.0


@dataclass(frozen=True)
class Other:
    first: float = 1.0
    second: float = 2.0


def adder(weight: np.ndarray) -> Callable[[float], np.ndarray]:
    def add(x: float) -> np.ndarray:
        return weight + x

    return add


def test_what_holds_the_same_has_the_same_digest(robot: Robot) -> None:
    assert digest(Pair()) == digest(Pair(1.0, 2.0))
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    assert digest(adder(np.arange(3.0))) == digest(adder(np.arange(3.0)))
    assert digest(robot) == digest(Robot.load())
    jump = standing(robot)
    assert digest(jump) == digest(Log(jump.name, {k: v.copy() for k, v in jump.columns.items()}, jump.info))


@pytest.mark.parametrize(
    ("one", "another"),
    [
        (Pair(), Pair(second=2.0000000000000004)),
        (Pair(), Other()),
        (1, 1.0),
        (1, True),
        ("ab", ["a", "b"]),
        (["ab", "c"], ["a", "bc"]),
        ({"a": 1, "b": 2}, {"a": 2, "b": 1}),
        (np.zeros(4), np.zeros((2, 2))),
        (np.zeros(4), np.zeros(4, np.float32)),
        (adder(np.zeros(3)), adder(np.ones(3))),
        (effects.effect("joint_damping", damping=0.4), effects.effect("joint_friction", torque_nm=0.4)),
        ({Target(0.5): 1}, {Target(0.6): 1}),
    ],
)
def test_any_difference_shows(one: object, another: object) -> None:
    assert digest(one) != digest(another)


def test_one_changed_sample_of_a_log_shows(robot: Robot) -> None:
    jump = standing(robot)
    moved = dict(jump.columns) | {"base_pos_x": jump["base_pos_x"] + np.eye(1, len(jump), 7)[0] * 1e-12}
    assert digest(jump) != digest(replace(jump, columns=moved))


def test_what_has_no_digest_is_refused() -> None:
    with pytest.raises(TypeError, match="no digest of a generator"):
        digest(x for x in range(3))


KEY = "a" * 64
MAKERS: dict[str, tuple[Callable, ...]] = {
    "train": (fit_task, export_model),
    "diagnose_withheld": (diagnose_folder,),
    "revisit": (diagnose_folder, further_jumps),
    "practise": (TrialSpec.run, identify_effects_config),
    "land": (TrialSpec.run, identify_effects_config),
    "land_corrected": (TrialSpec.run, identify_effects_config),
}
"""What makes the results of each stage with a cache."""
PLANS = ("jumping/planning", "jumping/models", "jumping/task.py")
NO_PART_OF_RESULTS = {"src/leapgap/runtime", "src/leapgap/jumping/__init__.py"}
"""What finds results, guards the folder they lie in, or runs and stops what makes them."""


@dataclass
class LibraryCopy:
    """A copy of the library whose files can be changed, and its keys before any change."""

    folder: Path
    unchanged: dict[str, list[str]]
    """Keys by stage, where they were asked for."""

    def keys(self, stage: str) -> list[str]:
        """Keys that the results of a stage have in the copy as it is now, as a new process would read it."""
        import_closure.library.cache_clear()
        import_closure.hash_of.cache_clear()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("leapgap.runtime.cache.PACKAGE", self.folder)
            patch.setattr(import_closure, "PACKAGE", self.folder)
            return [result_key(make, {"settings": 1}) for make in MAKERS[stage]]

    def changed_keys(self, stage: str, file: str, added: bytes | None = None) -> list[tuple[str, str]]:
        """Each key of a stage, and the same where a file of the library has a statement or one byte more."""
        if stage not in self.unchanged:
            self.unchanged[stage] = self.keys(stage)
        path = self.folder / file
        content = path.read_bytes()
        path.write_bytes(content + (added or (b"\nADDED = 1\n" if path.suffix == ".py" else b"\n")))
        try:
            return list(zip(self.unchanged[stage], self.keys(stage), strict=True))
        finally:
            path.write_bytes(content)


@pytest.fixture(scope="module")
def library_copy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LibraryCopy]:
    """One copy for all tests; the readings of it go with the last test."""
    folder = tmp_path_factory.mktemp("copy") / "leapgap"
    shutil.copytree(PACKAGE, folder, ignore=shutil.ignore_patterns("__pycache__"))
    yield LibraryCopy(folder, {})
    import_closure.library.cache_clear()
    import_closure.hash_of.cache_clear()


@pytest.mark.parametrize(
    ("stage", "file"),
    [
        ("train", "jumping/models/rigid_body.py"),
        ("train", "jumping/learning/training.py"),  # imported inside a function
        ("diagnose_withheld", "reports/report.html"),
        ("land", "robot/a1.xml"),
        ("diagnose_withheld", "effects/bodies.py"),  # found by its file name
        ("land", "jumping/control/jump_sequence.py"),
        ("revisit", "validation/off_table.py"),
    ],
)
def test_any_change_of_the_code_changes_the_key(stage: str, file: str, library_copy: LibraryCopy) -> None:
    assert any(one != other for one, other in library_copy.changed_keys(stage, file))


@pytest.mark.parametrize("added", [b"\n\n# a comment\n", b'\n"""Words below the last line."""\n'])
def test_a_comment_changes_no_key(added: bytes, library_copy: LibraryCopy) -> None:
    assert all(one == other for one, other in library_copy.changed_keys("train", "errors.py", added))


@pytest.mark.parametrize("stage", ["train", "diagnose_withheld", "land"])
@pytest.mark.parametrize(
    "file",
    [
        "reports/log_recording.py",
        "jumping/reports/landing.html",
        "runtime/cache.py",
        "__init__.py",
        "validation/scoring.py",
    ],
)
def test_code_that_shapes_no_result_changes_no_key(stage: str, file: str, library_copy: LibraryCopy) -> None:
    assert all(one == other for one, other in library_copy.changed_keys(stage, file))


@pytest.mark.parametrize("stage", MAKERS)
def test_keys_cover_the_library_code_that_dvc_lists(stage: str) -> None:
    covered = {dependency(name) for make in MAKERS[stage] for name in closure(make.__module__)}
    listed = {
        dependency(name) for name in hashes(module_of(stage), TREE) if name in TREE.modules and "leapgap." in name
    }
    listed -= NO_PART_OF_RESULTS
    # Plans of further jumps are inputs, hashed by their content.
    besides = PLANS if stage == "revisit" else ()
    assert listed - {f"src/leapgap/{name}" for name in besides} <= covered


def test_every_stage_that_keeps_results_is_checked_here() -> None:
    """A stage that makes pages reads results and keeps none."""
    own = {name for name in stages() if module_of(name) not in RENDERS}
    users = {name for name in own if "leapgap.runtime.cache" in hashes(module_of(name), TREE)}
    assert users == set(MAKERS)


def test_every_data_file_is_read_by_a_module_beside_it() -> None:
    """Or is the model of a real robot's logs, which ``make robots`` reads and no pipeline."""
    known = {path for module in TREE.modules for path in TREE.data_files(module)}
    named = re.findall(r"package:leapgap/(\S+)", (ROOT / "conf/robots/default.yaml").read_text())
    known |= {ROOT / "src/leapgap" / name for name in named}
    library = ROOT / "src/leapgap"
    there = {path for path in library.rglob("*") if path.suffix in DATA}
    assert there == {path for path in known if path.is_relative_to(library)}


def test_versions_of_the_libraries_in_use_are_in_the_key() -> None:
    assert {"torch", "lightning", "numpy"} <= TREE.libraries("leapgap.jumping.learning.experiment").keys()
    assert "torch" not in TREE.libraries("leapgap.diagnosis.diagnose")


def test_the_code_of_a_class_among_the_inputs_counts(tmp_path: Path, robot: Robot) -> None:
    acting = effects.effect("payload", mass_kg=1.0)
    assert "leapgap.effects.bodies" in modules_within({"acting": [acting], "weight": np.ones(2)})
    assert modules_within(robot) == {"leapgap.robot.model"}
    assert code_hash("leapgap.errors") != code_hash("leapgap.errors", "leapgap.effects.bodies")


def test_imports_of_every_form_are_followed(tmp_path: Path) -> None:
    files = {
        "__init__.py": "from p.big import everything\n",
        "a.py": "def f():\n    from . import b\n    from .deep.c import x\n",
        "b.py": "import importlib\nimportlib.import_module('p.d')\n",
        "d.py": "from p import plugins\n",
        "plugins/__init__.py": "import pkgutil\n",
        "plugins/one.py": "import p.deep.e\n",
        "deep/__init__.py": "",
        "deep/c.py": "import json, numpy\n",
        "deep/e.py": "",
        "deep/unused.py": "",
        "big.py": "",
    }
    for name, text in files.items():
        (tmp_path / "p" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "p" / name).write_text(text)
    tree = SourceTree((tmp_path / "p",))
    assert tree.closure("p.a") == {"p.a", "p.b", "p.d", "p.plugins", "p.plugins.one", "p.deep", "p.deep.c", "p.deep.e"}
    assert set(tree.libraries("p.a")) == {"numpy"}


def test_a_key_parses_each_file_of_its_code_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stage with a cache waits for its keys before anything else."""
    parsed = []

    def parse(*arguments: Any) -> Any:
        parsed.append(arguments)
        return original(*arguments)

    original = ast.parse
    monkeypatch.setattr(import_closure.ast, "parse", parse)
    tree = SourceTree((PACKAGE,))
    tree.code_hash("leapgap.logs.log")
    assert len(parsed) == len(tree.closure("leapgap.logs.log"))


def module_of(stage: str) -> str:
    return word("dvc.yaml", stage)


def store_result(cache: ResultCache, place: str, key: str = KEY, **texts: str) -> None:
    with cache.store(place, key) as folder:
        for ending, text in texts.items():
            (folder / f"{Path(place).name}.{ending}").write_text(text)


def names(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_a_result_is_there_for_its_key_only(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    assert cache.get("x/one", KEY) is None
    store_result(cache, "x/one", json="1", csv="2")
    assert cache.get("x/one", KEY) == tmp_path / "x/one"
    assert cache.get("x/one", "b" * 64) is None
    store_result(cache, "x/one", "b" * 64, json="3")
    assert names(tmp_path) == {"x/one.json", "x/one.key"}  # what the other key had besides is gone
    (tmp_path / "x/one.json").unlink()
    assert cache.get("x/one", "b" * 64) is None


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_result_that_was_not_finished_is_none(tmp_path: Path, error: type[BaseException]) -> None:
    cache = ResultCache(tmp_path)
    with pytest.raises(error), cache.store("x/one", KEY) as folder:
        (folder / "one.json").write_text("half")
        raise error
    assert cache.get("x/one", KEY) is None
    assert not names(tmp_path)


def test_scratch_outlives_a_kill_and_goes_with_its_key(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    with pytest.raises(KeyboardInterrupt), cache.store("x/one", KEY):
        cache.scratch("x/one", KEY).mkdir()
        (cache.scratch("x/one", KEY) / "last.ckpt").write_text("step 3")
        raise KeyboardInterrupt
    again = ResultCache(tmp_path)
    again.expect("x/one", KEY)
    again.sweep()
    assert (again.scratch("x/one", KEY) / "last.ckpt").read_text() == "step 3"
    other = ResultCache(tmp_path)
    other.expect("x/one", "b" * 64)
    other.sweep()
    assert not list(tmp_path.iterdir())


def test_only_what_a_record_names_is_removed(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    for place in ("x/one", "x/two", "y/three"):
        store_result(cache, place, json="1")
    with cache.store("z", KEY) as folder:
        (folder / "z").mkdir()
        (folder / "z/report.json").write_text("1")
    foreign = ("x/one.txt", "x/notes.json", "z/mine.md", "my.key", "x/list.key", "empty/of.ours")
    for name in foreign:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
    (tmp_path / "x/list.key").write_text(json.dumps({"key": KEY, "files": ["one.txt"]}))
    (tmp_path / "nothing").mkdir()
    later = ResultCache(tmp_path)
    later.expect("x/two")
    later.sweep()
    assert names(tmp_path) == {"x/two.json", "x/two.key", *foreign}
    assert (tmp_path / "nothing").is_dir() and not (tmp_path / "y").exists()


def test_a_record_cannot_name_a_file_outside(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    cache = ResultCache(tmp_path / "out")
    store_result(cache, "one", json="1")
    record = json.loads((tmp_path / "out/one.key").read_text())
    (tmp_path / "out/one.key").write_text(json.dumps(record | {"files": ["../mine.txt"]}))
    ResultCache(tmp_path / "out").sweep()
    assert (tmp_path / "mine.txt").exists()


def test_files_of_another_place_are_refused(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    with pytest.raises(ValueError, match=r"other\.json in its result"), cache.store("one", KEY) as folder:
        (folder / "other.json").write_text("1")
    with pytest.raises(ValueError, match="has no dot"):
        cache.get("a.b", KEY)


def test_a_sweep_leaves_another_output_below_it_alone(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    claim_folder(inner, "leapgap test")
    with ResultCache(inner).store("one", "a" * 64) as folder:
        (folder / "one.json").write_text("{}")
    before = {path: path.read_bytes() for path in inner.iterdir()}
    ResultCache(tmp_path).sweep()
    assert {path: path.read_bytes() for path in inner.iterdir()} == before
