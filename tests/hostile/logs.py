"""Corrupted logs: every reader is given a folder with three whole logs and a harmed one; what it does is classified.

The readers run in processes of their own, with limits of time and memory. What they may do: refuse, set the harmed log
aside (when it is read, or since it departs from its fellows), or accept it. What was accepted is held against the whole
log: it is harmless if it says nearly the same, else nonsense.
"""

import os
import pickle
import resource
import select
import shutil
import struct
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.code import ROOT
from tests.hostile.base_logs import FORMATS, Columns, Format, write_own
from tests.hostile.column_harms import HARMS
from tests.hostile.file_harms import FILE_HARMS, main_file, repeated
from tests.hostile.harmful_files import SPECIALS
from tests.hostile.metadata_harms import METADATA
from tests.hostile.other_files import OTHER_FILES, harms, judge_other, write_harmed

OUTCOMES = (
    *("refused", "set_aside", "accepted_harmless", "accepted_nonsense"),
    *("traceback", "hang", "memory", "control"),
)
LONGEST_S, MOST_BYTES, ADDRESSES = 30.0, 2_500_000_000, 12_000_000_000
"""Limits of one case: time, memory beyond what the process held before, and addresses of the process."""
HARMLESS = 0.05
"""Largest departure of an accepted value from the truth, as a share of the range of its column."""
VICTIM, FELLOWS = 1, (0, 2, 3)
CASES_AT_ONCE = 200
"""Of one piece, after which the figures are on disk."""
WHOLE_FILE_SEEDS = 8
"""Cases of each harm to a file and format, with other random places."""


@dataclass(frozen=True)
class Case:
    """A log of one format or another file, and what is done to it before it is read."""

    number: int
    format: str
    harm: str
    """``columns``, ``file``, ``metadata`` or ``special``; ``other`` for a file that is no log."""
    name: str

    def __str__(self) -> str:
        """Its name for a person."""
        return f"{self.format}/{self.name}#{self.number}"


@dataclass(frozen=True)
class Result:
    """What became of a case."""

    case: Case
    outcome: str
    says: str


def cases() -> list[Case]:
    """All cases in a fixed order."""
    kinds: list[tuple[str, str, str]] = []
    for layout in FORMATS:
        kinds += [(layout.name, "columns", name) for name in HARMS if may_be_written(layout, name)]
        kinds += [(layout.name, "file", name) for name in repeated(WHOLE_FILE_SEEDS)]
    kinds += [(layout, "metadata", name) for layout in ("own", "own_unchecked") for name in METADATA]
    kinds += [(layout, "special", name) for name, (layout, _) in SPECIALS.items()]
    kinds += [(kind, "other", name) for kind in OTHER_FILES for name in harms(WHOLE_FILE_SEEDS)]
    return [Case(number, *kind) for number, kind in enumerate(kinds)]


def may_be_written(layout: Format, name: str) -> bool:
    """Whether a format can hold such columns at all."""
    if layout.name in ("published", "ros", "mcap", "sqlite3"):
        unwritable = ("no_", "one_joint", "part_of", "unicode_joint", "texts", "words", "complex", "dates", "no_row")
        return not name.startswith(unwritable) and name not in ("time_nan",)
    if name == "complex":
        return layout.name in ("npz", "hdf5", "mat")
    if name == "dates":
        return layout.name in ("npz", "csv", "parquet", "own", "own_unchecked")
    if layout.name == "mat":
        unwritable = ("unicode_", "html_column", "long_name", "text", "words")
        return not name.startswith(unwritable)
    return True


def log_path(folder: Path, layout: Format, number: int) -> Path:
    """Where a log of a format lies."""
    return folder / (str(number) if layout.name == "published" else f"log_{number}{layout.suffix}")


def write_case(layout: Format, harm: str, name: str, path: Path, rng: np.random.Generator, log: int) -> Columns:
    """Write one harmed log; the columns that it would have had."""
    columns = layout.log(log)
    if harm == "special":
        SPECIALS[name][1](path)
    elif harm == "metadata":
        write_own(columns, path, METADATA[name])
    elif harm == "columns":
        layout.write(HARMS[name](columns, rng), path)
    else:
        layout.write(columns, path)
        FILE_HARMS[name](main_file(path, rng), rng)
    return columns


def clear(path: Path) -> None:
    """Remove what a case left, whatever it is."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif path.is_symlink() or path.exists():
        path.unlink()


class Reader:
    """In the process that reads: robots loaded once, and one case after the other."""

    def __init__(self, models: Path) -> None:
        from leapgap.robot.model import Robot

        self.models, self.robots = models, {}
        self.terrain: dict[str, tuple[Any, ...]] = {}
        for layout in FORMATS:
            path = models / f"{layout.name}.xml"
            self.robots[layout.name] = Robot.load(path) if layout.model else Robot.load()

    def judge(self, layout: Format, folder: Path, truth: Columns) -> tuple[str, str]:
        """Outcome of one case, and the reason in words."""
        from leapgap.diagnosis.departing_logs import without_departing
        from leapgap.errors import InputError
        from leapgap.logs.consistency import remarks
        from leapgap.logs.importers import log_format
        from leapgap.logs.reading import read_folder, read_foreign
        from leapgap.settings import from_mapping

        robot = self.robots[layout.name]

        def read(source: Path) -> Any:
            if layout.importer is None:
                return read_folder(source, robot)
            importer = log_format(layout.importer)
            options = from_mapping(importer.Options, dict(layout.options), "options")
            return read_foreign(importer, source, robot, options)

        victims = ("log_1", "log_1.parquet", "log_1_1", "jump_01")
        if layout.name not in self.terrain:
            whole = read(self.models / layout.name).logs
            self.terrain[layout.name] = next(log.info.terrain for log in whole if log.name in victims)
        try:
            readings = read(folder)
            kept, departing = without_departing(readings.logs)
        except InputError as error:
            return "refused", str(error)
        for one in (*readings.set_aside, *departing):
            if one.name not in victims:
                return "traceback", f"a whole log was set aside: {one}"
        aside = [one for one in (*readings.set_aside, *departing) if one.name in victims]
        if aside:
            return "set_aside", aside[0].reason
        log = next((one for one in kept if one.name in victims), None)
        if log is None:
            return "refused", "no log was found in it"
        if not same_terrain(log.info.terrain, self.terrain[layout.name]):
            return "accepted_nonsense", f"terrain {log.info.terrain}"
        return compare(log, truth, remarks(log.columns))


def same_terrain(found: Sequence[Any], whole: Sequence[Any]) -> bool:
    """Whether the blocks of a log are those of the whole log, to a centimetre: a reader may infer them from it."""
    numbers = [[(box.x_m, box.y_m, *box.size_m, box.top_m) for box in boxes] for boxes in (found, whole)]
    return len(found) == len(whole) and bool(np.allclose(*numbers, rtol=0, atol=0.01))


def compare(log: Any, truth: Columns, remarks: Sequence[str]) -> tuple[str, str]:
    """Whether an accepted log says what the whole one says: each row at its time, within a share of the range."""
    step = truth["time"][1] - truth["time"][0]
    latest = truth["time"][-1] - log.columns["time"][-1]
    lost = np.arange(0, max(latest, 0) + step / 2, step)  # rows lost at the begin: time counts from the first one left
    return min((compare_from(log, truth, remarks, begin) for begin in lost[:20]), key=lambda one: one[0])


def compare_from(log: Any, truth: Columns, remarks: Sequence[str], begin: float) -> tuple[str, str]:
    """The same with the log's first row at one time of the whole log."""
    time, step = log.columns["time"] + begin, truth["time"][1] - truth["time"][0]
    rows = np.clip(np.searchsorted(truth["time"], time - 1e-6), 0, len(truth["time"]) - 1)
    late = float(np.abs(truth["time"][rows] - time).max())
    if late > step:
        return "accepted_nonsense", f"times are {late:.3g} s off"
    worst, where = 0.0, ""
    for name, values in truth.items():
        if name in log.columns and name != "time":
            scale = max(float(np.ptp(values)), float(np.abs(values).max()) * 0.2, 1e-3)
            off = float(np.abs(log.columns[name] - values[rows]).max()) / scale
            worst, where = (off, name) if off > worst else (worst, where)
    if worst > HARMLESS:
        return "accepted_nonsense", f"{where} is {worst:.2g} of its range off"
    return "accepted_harmless", f"{where} is {worst:.1g} of its range off" + "".join(f"; {one}" for one in remarks)


def serve(models: Path) -> None:
    """Read cases from standard input and write their outcomes to standard output, until there is none."""
    from leapgap.errors import CONTROL

    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    reader = Reader(models)
    layouts = {layout.name: layout for layout in FORMATS}
    send(out, ("ready", ""))
    while (raw := receive(sys.stdin.buffer)) is not None:
        name, folder, truth = raw
        before = peak_bytes()
        try:
            if name in OTHER_FILES:
                outcome, says = judge_other(name, Path(folder))
            else:
                outcome, says = reader.judge(layouts[name], Path(folder), truth)
                outcome = "control" if CONTROL.search(says.replace("\n", "")) else outcome
        except BaseException:
            outcome, says = "traceback", traceback.format_exc()[-1500:]
        if peak_bytes() - before > MOST_BYTES:
            outcome, says = "memory", f"{(peak_bytes() - before) / 1e9:.1f} GB: {says}"
        send(out, (outcome, says))


def peak_bytes() -> int:
    """Most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def send(stream: Any, value: object) -> None:
    """Write a value with its length before it."""
    data = pickle.dumps(value)
    stream.write(struct.pack("<Q", len(data)) + data)
    stream.flush()


def receive(stream: Any) -> Any:
    """Read a value as ``send`` writes it; None at the end."""
    head = stream.read(8)
    return pickle.loads(stream.read(struct.unpack("<Q", head)[0])) if len(head) == 8 else None


class Worker:
    """A process that reads, started anew when it hangs or dies."""

    def __init__(self, models: Path) -> None:
        self.models = models
        self.process = self.start()

    def start(self) -> subprocess.Popen[bytes]:
        """A new process, ready to read."""
        code = f"from pathlib import Path; from tests.hostile import logs; logs.serve(Path({str(self.models)!r}))"
        path = os.pathsep.join(filter(None, (str(ROOT), str(ROOT / "src"), os.environ.get("PYTHONPATH"))))
        environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        if receive(process.stdout) is None:
            raise RuntimeError("the process that reads cases did not start")
        return process

    def judge(self, layout: str, folder: Path, truth: Columns) -> tuple[str, str]:
        """Outcome of one case of a format or kind of file within its time."""
        assert self.process.stdin is not None and self.process.stdout is not None
        send(self.process.stdin, (layout, str(folder), truth))
        ready, _, _ = select.select([self.process.stdout], [], [], LONGEST_S)
        found = receive(self.process.stdout) if ready else None
        if found is not None:
            return tuple(found)
        self.close()
        code = self.process.returncode
        self.process = self.start()
        return ("traceback", f"the process died ({code})") if ready else ("hang", f"no answer in {LONGEST_S:g} s")

    def close(self) -> None:
        """Kill the process that reads, and wait until it is gone."""
        self.process.kill()
        self.process.wait()


def prepared(folder: Path) -> dict[str, Path]:
    """Folders with whole logs, one a format; and models of their robots, each beside the victim as it was."""
    (folder / "models").mkdir()
    found = {}
    for layout in FORMATS:
        (folder / "models" / f"{layout.name}.xml").write_text(layout.model)
        found[layout.name] = folder / layout.name
        found[layout.name].mkdir()
        for number in FELLOWS:
            layout.write(layout.log(number), log_path(found[layout.name], layout, number))
        (folder / "models" / layout.name).mkdir()
        layout.write(layout.log(VICTIM), log_path(folder / "models" / layout.name, layout, VICTIM))
    return found


def run_cases(chosen: Sequence[Case], seed: int) -> list[Result]:
    """Judge cases one after the other."""
    layouts, results = {layout.name: layout for layout in FORMATS}, []
    with tempfile.TemporaryDirectory() as name:
        folders, worker = prepared(Path(name)), Worker(Path(name) / "models")
        try:
            for case in chosen:
                rng = np.random.default_rng([seed, case.number])
                if case.harm == "other":
                    path = write_harmed(case.format, case.name, Path(name) / "other", rng)
                    results.append(Result(case, *worker.judge(case.format, path, {})))
                    clear(Path(name) / "other")
                    continue
                layout = layouts[case.format]
                victim = log_path(folders[case.format], layout, VICTIM)
                truth = write_case(layout, case.harm, case.name, victim, rng, VICTIM)
                results.append(Result(case, *worker.judge(layout.name, folders[case.format], truth)))
                clear(victim)
        finally:
            worker.close()
    return results


def figures(results: Sequence[Result]) -> Mapping[str, int]:
    """Number of cases, and of each outcome."""
    counts = Counter(result.outcome for result in results)
    return {"inputs": len(results), **{outcome: counts[outcome] for outcome in OUTCOMES}}


def report(results: Sequence[Result]) -> str:
    """The cases that must not be, and those that physics cannot see, a line each."""
    bad = [one for one in results if one.outcome in ("traceback", "hang", "memory", "control", "accepted_nonsense")]
    return "\n".join(f"{one.outcome}: {one.case}: {one.says}" for one in bad)


def cases_number(number: int, seed: int) -> Mapping[str, int]:
    """Figures of the piece of the cases of that number; the bad ones are printed."""
    results = run_cases(cases()[number * CASES_AT_ONCE :][:CASES_AT_ONCE], seed)
    print(report(results), flush=True)
    return figures(results)
