"""Tuning cases of every family drawn, diagnosed within a limit of processor time, and scored into one table."""

import multiprocessing
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from leapgap.diagnosis.report import round_floats
from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.log import read_logs
from leapgap.reports.diagnosis import REPORT, diagnose_folder
from leapgap.reports.verdict_jobs import Job
from leapgap.robot.mjcf import own_model
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json, write_metrics
from leapgap.runtime.cache import ResultCache, foreign_code, result_key
from leapgap.runtime.executor import Executor
from leapgap.validation.case import published_case, write_case
from leapgap.validation.half_scores import open_outcome, realised_closure
from leapgap.validation.outcome import truth_in_words
from leapgap.validation.seal import PUBLISHED, SEALS, open_truth
from leapgap.validation.withholding import write_truth
from stages.bench_table import line, markdown, row_of, row_without_answer, summary

VERDICTS, ROWS, TIMES = "verdicts", "rows", "times.json"
ROBOTS = "robots"
DRAWN = (
    "size=blind",
    "executor=local",
    "withhold/robot=[]",
    "withhold.published=null",
    "~withhold.halves.reported",
    "~withhold.further.reported",
    "~withhold.owners.reported",
)
NOTHING = (
    "withhold.halves.tuning={single: 0, pair: 0, triple: 0, nameless: 0, none: 0}",
    "withhold.further.tuning={uneven: 0, third: 0, too_high: 0}",
    "withhold.owners.tuning.cases=0",
)
"""What is drawn where a family does not ask for it; no reported half has a part in it."""


@dataclass(frozen=True)
class BenchSettings:
    """Section ``bench`` of the configuration."""

    cases: str
    out: str | None
    metrics: str | None
    families: list[str]
    only: list[str]
    limit_s: int
    threads: int
    raw: str
    settings: dict[str, Any]
    draws: dict[str, list[str]]

    def __post_init__(self) -> None:
        """``ValueError`` for names of families that nothing draws."""
        if unknown := set(self.families) - {*self.draws, PUBLISHED, ROBOTS}:
            raise ValueError(f"families {', '.join(sorted(unknown))}: some of {', '.join(self.draws)}")


def run_families(
    chosen: BenchSettings, settings: Settings, robot: Robot, cache: ResultCache, executor: Executor
) -> None:
    """Draw, diagnose and score the cases of all families but the real robots; the table grows family by family.

    ``settings`` of the diagnosis; ``robot`` of cases that have none of their own.
    """
    table: dict[str, Any] = {}
    for family in chosen.families:
        cases = [] if family == ROBOTS else cases_of(family, chosen)
        jobs = [
            Job(f"{VERDICTS}/{family}/{case.name}", case, own_model(case) or robot.path, settings, chosen.threads)
            for case in cases
            if case.name in chosen.only or not chosen.only
        ]
        todo = [job for job in jobs if chosen.limit_s or cache.get(job.place, job.key) is not None]
        rows = {}
        for name, row in executor.map(partial(judge, cache, chosen.limit_s, robot), todo):
            rows[name] = row
            print(line(name, row), flush=True)
        if rows:
            missing = [case.name for case in cases if case.name not in rows]
            table[family] = {"figures": summary(list(rows.values())), "missing": missing, "cases": rows}
            write_table(chosen, table)
    print(markdown(table))


def write_table(chosen: BenchSettings, table: Mapping[str, Any]) -> None:
    """Write these families into the file of the table, where one is asked for; the others in it stay."""
    if chosen.metrics and table:
        path = Path(chosen.metrics)
        before = read_json(path) if path.is_file() else {}
        write_metrics(path, round_floats({**before, **table}))


def cases_of(family: str, chosen: BenchSettings) -> list[Path]:
    """Folders of logs of a family, which is drawn where it is not there; none of published jumps that are not there."""
    folder = Path(chosen.cases) / family
    logs, truth = folder / "logs", folder / "truth"
    if family == PUBLISHED and not (logs / SEALS).is_file():
        write_published(chosen.raw, folder, logs, truth)
    elif not (logs / SEALS).is_file():
        run("withhold", *DRAWN, *NOTHING, *chosen.draws[family], f"withhold.logs={logs}", f"withhold.truth={truth}")
    return sorted(path for path in logs.iterdir() if path.is_dir()) if logs.is_dir() else []


def write_published(raw: str, folder: Path, logs: Path, truths: Path) -> None:
    """Write the published jumps as two cases: every other one, with the rest as proof, and all together."""
    jumps = folder / "jumps"
    if not jumps.is_dir():
        run("import_logs", f"import_logs.source={raw}", f"import_logs.out={jumps}")
    found = read_logs(jumps)
    if not found:
        print(f"{PUBLISHED}: no jumps in {raw}, left out")
        return
    halves = published_case(found, len(found))
    cases = {"halves": halves, "all": replace(halves, logs=tuple(found), proof=())}
    seals = [write_truth(write_case(case, logs / name, truths / name), truths, name) for name, case in cases.items()]
    write_json(logs / SEALS, dict(seals))


def run(stage: str, *arguments: str) -> None:
    """Run another stage; what it says of bad input is the message."""
    done = subprocess.run([sys.executable, "-m", f"stages.{stage}", *arguments], capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"stages.{stage}", done.stderr.strip(), "an exit code of 0", "see its message")


def judge(cache: ResultCache, limit_s: int, robot: Robot, job: Job) -> tuple[str, Mapping[str, Any]]:
    """Name and row of a case, from the cache where they are there."""
    verdict = cache.folder / job.place
    key = job.key
    kept = cache.get(job.place, key)
    if kept is None or is_to_be_tried_again(read_json(verdict / TIMES), limit_s):
        with cache.store(job.place, key) as folder:
            write_json(folder / job.name / TIMES, diagnosed(job, folder / job.name, limit_s))
    truths = job.logs.parent.parent / "truth"
    place = f"{ROWS}/{job.logs.parent.parent.name}/{job.name}"
    scored_from = [key, read_json(truths / f"{job.name}.json"), read_json(verdict / TIMES)]
    of_row = result_key(realised_closure, [*scored_from, foreign_code(row_of.__module__)])
    path = cache.folder / f"{place}.json"
    if cache.get(place, of_row) is None:
        row = scored(job, verdict, truths, robot)
        with cache.store(place, of_row) as folder:
            write_json(folder / path.name, row)
    return job.name, read_json(path)


def is_to_be_tried_again(times: Mapping[str, Any], limit_s: int) -> bool:
    """Whether a case ended at a limit that was less than the present one."""
    return times["limit_s"] is not None and times["limit_s"] < limit_s


def diagnosed(job: Job, folder: Path, limit_s: int) -> dict[str, Any]:
    """Diagnose a case in a process of its own, which ends at the limit; its times, and what went wrong."""
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=diagnose_within, args=(job, folder, limit_s, send))
    begin = time.perf_counter()
    process.start()
    send.close()
    try:
        cpu_s, error = receive.recv()
    except EOFError:  # ended from outside
        cpu_s, error = float(limit_s), f"no answer in {limit_s} s of processor time"
    process.join()
    if process.exitcode and process.exitcode != -signal.SIGXCPU:
        error = f"ended by {signal.Signals(-process.exitcode).name}"
    times = {"cpu_s": cpu_s, "wall_s": time.perf_counter() - begin, "error": error}
    return times | {"limit_s": limit_s if process.exitcode == -signal.SIGXCPU else None}


def diagnose_within(job: Job, folder: Path, limit_s: int, send: Connection) -> None:
    """Diagnose a case and write its report; the processor time that it took, and what went wrong, are sent."""
    import resource  # of POSIX: on Windows this command alone does not run

    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 1))
    error = ""
    try:
        found = diagnose_folder(job.logs, Robot.load(job.robot), job.settings, threads=job.threads)
        if found is not None:
            found.write(folder)
    except Exception as problem:
        error = f"{type(problem).__name__}: {problem}"
    send.send((time.process_time(), error))


def scored(job: Job, verdict: Path, truths: Path, robot: Robot) -> dict[str, Any]:
    """The row of a case."""
    times = read_json(verdict / TIMES)
    if (verdict / REPORT).is_file():
        found = open_outcome(job.name, job.logs.parent, truths, verdict.parent, robot, seed=1)
        row = row_of(found, read_json(verdict / REPORT))
    else:
        truth = open_truth(truths, job.logs.parent, job.name)
        row = row_without_answer(truth, truth_in_words(truth), times["error"])
    return round_floats(row | {"cpu_s": times["cpu_s"], "wall_s": times["wall_s"]})
