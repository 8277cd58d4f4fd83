"""The instrument as functions: read logs, check them, replay them, diagnose them against a robot."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Any

from leapgap.diagnosis.checks import run_checks
from leapgap.diagnosis.checks.base import CheckResult
from leapgap.diagnosis.compare import Comparison, compare_logs
from leapgap.diagnosis.judge import Judgement, change_of_effect, judge_correction
from leapgap.diagnosis.report import Provenance, content_sha256
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.effects.model_change import changes_between
from leapgap.errors import InputError
from leapgap.logs import log as log_file
from leapgap.logs import reading
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log
from leapgap.logs.map_proposal.report import first_file
from leapgap.logs.reading import Readings
from leapgap.reports.diagnosis import ChosenLogs, Report, diagnose_chosen, diagnose_folder
from leapgap.reports.kept import record_report
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, sha256
from leapgap.simulation.corrected import corrected_in, read_corrected
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

PathLike = str | Path
Logs = Sequence[Log] | PathLike  # logs, or the file or folder to read them from


def read_logs(
    source: Logs, format: str | None = None, robot: Robot | PathLike | None = None, options: Any = None
) -> list[Log]:
    """Read the logs of a file or folder, in the order of their names.

    Without ``format`` they are Parquet files as ``write_log`` writes them. With it (``csv``, ``ros``, others: see
    ``leapgap import --help``) they are read as that, several logs a file where the options cut it. ``robot`` then names
    the joints, and ``options`` is an instance of the format's own dataclass. ``InputError`` says what cannot be read.
    """
    if not isinstance(source, PathLike):
        return list(source)
    path = Path(source)
    if format is not None:
        readings = read_foreign(path, format, robot, options)
        if readings.set_aside:
            do = "repair or remove them"
            raise InputError(path, "logs that cannot be used", "whole logs", do, readings.set_aside)
        return list(readings.logs)
    loaded = None if robot is None else load_robot(robot)
    return some(log_file.read_logs(path) if path.is_dir() else [log_file.read_log(path)], path, "*.parquet", loaded)


def some(logs: Sequence[Log], path: Path, kind: str, robot: Robot | None = None) -> list[Log]:
    """The logs; none is an ``InputError``."""
    if not logs:
        raise no_logs(path, kind, robot)
    return list(logs)


def no_logs(path: Path, kind: str, robot: Robot | None = None) -> InputError:
    """The refusal of a folder without logs; it names the command that would import what is there."""
    try:
        layout, _ = first_file(path, None)
    except InputError:
        return InputError(path, f"no {kind}", "one log or more", "name the folder of the logs, or their format")
    model = quote(str(robot.path)) if robot else "<robot.xml>"
    command = f"leapgap import {quote(str(path))} {model} --out imported"
    do = f"{command}; then name the folder 'imported' in place of this one"
    return InputError(path, f"no {kind}, but logs of format {layout.name}", "logs in leapgap's format", do)


def read_foreign(path: Path, format: str, robot: Robot | PathLike | None, options: Any) -> Readings:
    """Logs of another format, of a file or below a folder; those that cannot be used are set aside, if two are left."""
    layout = log_format(format)
    if robot is None:
        raise InputError("read_logs", "no robot", "the model whose joints the logs are of", "name robot=…")
    if not path.exists():
        raise InputError(path, "no such folder", f"a folder or file of logs of format {format}", "name the folder")
    loaded, chosen = load_robot(robot), layout.Options() if options is None else options
    readings = reading.read_foreign(layout, path, loaded, chosen)
    if not readings.logs:
        raise InputError(path, f"no logs of format {format}", "one log or more", "name the folder of the logs")
    return readings


def load_robot(robot: Robot | PathLike) -> Robot:
    """A robot as it is, or loaded from its model file."""
    return robot if isinstance(robot, Robot) else Robot.load(robot)


def write_log(log: Log, path: PathLike) -> Path:
    """Write a log as one Parquet file, whole or not at all; the same log gives the same bytes."""
    log_file.write_log(log, Path(path))
    return Path(path)


def replay(logs: Logs, robot: Robot | PathLike, effects: Sequence[Effect] = ()) -> list[Log]:
    """Replay the logged commands in simulation, from each log's first state; measured columns are simulated.

    ``robot`` may be the folder ``corrected`` of a report, whose effects are simulated, too. ``effects`` are added to
    the robot.
    """
    folder = isinstance(robot, PathLike) and Path(robot).is_dir()
    loaded, own = read_corrected(robot) if folder else (load_robot(robot), ())  # type: ignore[arg-type]
    read = read_logs(logs)
    replayer = Replayer(loaded, max(1, *(len(log.info.terrain) for log in read)))
    motions = replayer.motions([Rollout(log, (*own, *effects)) for log in read])
    return [replayer.as_log(motion, log) for motion, log in zip(motions, read, strict=True)]


@dataclass(frozen=True)
class CheckReport:
    """What the consistency checks say of some logs."""

    results: tuple[CheckResult, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return all(result.passed for result in self.results)

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """A line for each check."""
        lines = [f"{'passed' if one.passed else 'FAILED'}  {one.name}: {one.says}" for one in self.results]
        return "\n".join(lines) or "nothing could be checked: the logs lack the columns, or are short or still"


def check(logs: Logs, robot: Robot | PathLike | None = None, settings: Settings | None = None) -> CheckReport:
    """Check the consistency of logs: clocks, velocities, free fall, planted feet, wiring. Takes seconds.

    Without a robot, the checks that need a model are left out.
    """
    loaded = None if robot is None else load_robot(robot)
    return CheckReport(
        tuple(run_checks(read_logs(logs, robot=loaded), loaded, (settings or Settings()).check_thresholds))
    )


def diagnose(
    logs: Logs,
    robot: Robot | PathLike,
    settings: Settings | None = None,
    effects: Sequence[str | type[Effect]] = (),
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
    descriptions: Sequence[Robot | PathLike] = (),
    without: Sequence[str] = (),
    also: Sequence[type[Effect]] = (),
) -> Report:
    """Identify which unmodelled effects cause the difference between logs and simulation.

    Of a folder, logs that cannot be used are set aside, and so are, of any logs, those that differ from the others;
    the report names them. ``robot`` is a MuJoCo model, ``settings`` those that were validated unless others are given.
    ``effects`` limits the search, as ``--effects`` does: names that ``leapgap effects`` lists, or classes of your own;
    empty: those that are on by default. ``without`` leaves effects out, and ``also`` adds classes of your own to those
    on by default. ``descriptions`` are other models of the same robot, each judged as it is. ``progress`` gets lines
    for a person. ``threads`` (None: all cores) changes the time it takes and nothing else.
    """
    loaded, given = load_robot(robot), settings or Settings()
    own = tuple(dict.fromkeys([*(one for one in effects if not isinstance(one, str)), *also]))
    names = [one if isinstance(one, str) else one.name for one in effects]
    chosen = replace(given, effects=[*given.effects, *names], without=[*given.without, *without])
    others, record = [load_robot(one) for one in descriptions], record_report if find_spec("rerun") else None
    if isinstance(logs, PathLike) and Path(logs).is_dir():
        report = diagnose_folder(Path(logs), loaded, chosen, progress, threads, own, others, record)
        if report is None:
            raise no_logs(Path(logs), "*.parquet", loaded)
        return report
    read = read_logs(logs)
    files = {log.name: sha256(Path(logs)) for log in read} if isinstance(logs, PathLike) else None
    provenance = Provenance.of(read, loaded, asdict(chosen), files)
    some_logs = ChosenLogs.of(Readings(tuple(read)), progress)
    return diagnose_chosen(some_logs, loaded, chosen, own, provenance, progress, threads, others, record)


def judge(
    correction: PathLike,
    logs: Logs,
    nominal: Robot | PathLike | None = None,
    settings: Settings | None = None,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
) -> Judgement:
    """Say which changes of a corrected model are supported by logs that it was not fitted on.

    ``correction`` is the corrected model file, from whatever tool, or the folder of a report. ``nominal`` is the model
    that a file corrects; a report brings its own. Logs that a report was made from are left out.
    """
    path, notes, read = Path(correction), [], read_logs(logs)
    if path.is_dir():
        folder = corrected_in(path)
        robot, own = read_corrected(folder)
        robot = robot if nominal is None else load_robot(nominal)
        changes = [change_of_effect(effect, robot) for effect in own]
        known = set(read_json(path / "report.json")["provenance"]["logs"].values()) if folder != path else set()
        used = [log.name for log in read if known & {content_sha256(log), *hashes_of(logs, log.name)}]
        if len(used) == len(read):
            expected = "logs that the correction was not fitted on"
            raise InputError(path, "the same logs that this report was made from", expected, "name other logs")
        read = [log for log in read if log.name not in used]
        notes += [f"left out, since the report was made from them: {', '.join(used)}"] if used else []
    else:
        if nominal is None:
            raise InputError(
                "--nominal", "no model", "the model that the file corrects", "name it: --nominal robot.xml"
            )
        robot = load_robot(nominal)
        changes = changes_between(robot, load_robot(path))
    return judge_correction(read, robot, changes, settings, progress, threads, notes)


def compare(
    before: Logs,
    after: Logs,
    robot: Robot | PathLike,
    settings: Settings | None = None,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
) -> Comparison:
    """Say what changed between two sets of logs of one robot; model errors that both sets share cancel."""
    loaded = load_robot(robot)
    earlier, later = (read_logs(logs, robot=loaded) for logs in (before, after))
    return compare_logs(earlier, later, loaded, settings, progress, threads)


def hashes_of(source: Logs, name: str) -> list[str]:
    """SHA-256 of the file of a log, where the logs were read from a folder or file."""
    if not isinstance(source, PathLike):
        return []
    path = Path(source)
    file = path / f"{name}.parquet" if path.is_dir() else path
    return [sha256(file)] if file.is_file() else []
