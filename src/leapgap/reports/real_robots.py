"""Logs of real robots diagnosed, each with its report, and held against published answers."""

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.importers.base import LogFormat
from leapgap.reports.diagnosis import CORRECTED, REPORT, diagnose_logs
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.simulation.corrected import MODEL
from leapgap.validation.real_robots import RealCase, outcome_of, published_pushes, read_case, refusal, toss_loss

ROW = ".json"  # ending of the file with the row of a case, beside the folder of its report
Source = tuple[LogFormat, Any]  # format and options of an import


def judge_all(
    cases: Mapping[str, RealCase],
    raw: Path,
    importer: Callable[[str], Source],
    settings: Settings,
    pushes: Mapping[str, Mapping[str, str]],
    out: Path,
) -> dict[str, Mapping[str, Any]]:
    """The rows of all cases; reports lie below ``out``, and those of other cases are removed there.

    ``importer``: the source of a name; ``pushes``: by case, joint → column of the torque that pushed it.
    """
    cache = ResultCache(out)
    for name in cases:
        cache.expect(name)
    cache.sweep()
    rows: dict[str, Mapping[str, Any]] = {}
    for name, case in cases.items():
        if case.import_logs is None:
            rows[name] = refusal(case, raw, f"robots.cases.{name}")
            print(f"{name}: refused. {rows[name]['reason']}", flush=True)
        else:
            rows[name] = judge(cache, name, case, raw, importer(case.import_logs), settings, pushes.get(name, {}))
    return rows


def judge(
    cache: ResultCache,
    name: str,
    case: RealCase,
    raw: Path,
    source: Source,
    settings: Settings,
    pushes: Mapping[str, str],
) -> Mapping[str, Any]:
    """The row of one case, from the cache where it is there. Its report lies at the case's place in the cache."""
    with tempfile.TemporaryDirectory() as models:
        corrected = corrected_by(case, cache.folder, name)
        robot, logs = read_case(case, raw, *source, Path(models), corrected)
        published = published_pushes(raw / case.source, pushes)
        settings = replace(settings, effects=case.effects) if case.effects else settings
        key = result_key(diagnose_logs, [case, robot, logs, settings, published])
        if cache.get(name, key) is None:
            begin = time.perf_counter()
            report = diagnose_logs(logs, robot, settings, progress=partial(print, flush=True))
            outcome = outcome_of(case, report.content, time.perf_counter() - begin, published)
            with cache.store(name, key) as folder:
                report.save(folder / name)
                if case.half_edge_m is not None:
                    # ``toss_loss`` of the nominal model, and of the corrected one where there is one
                    files = {"nominal": robot.path, "corrected": folder / name / CORRECTED / MODEL}
                    outcome["loss"] = {
                        of_loss: toss_loss(file, logs, case.half_edge_m)
                        for of_loss, file in files.items()
                        if file.is_file()
                    }
                write_json(folder / f"{name}{ROW}", outcome)
    row = read_json(cache.folder / f"{name}{ROW}")
    verdict = "right" if row["right"] else "FALSE NAME" if row["false_name"] else "missed"
    sentence = read_json(cache.folder / name / REPORT)["sentence"]
    print(f"{name}: {'not judged' if case.expected is None else verdict}. {sentence}", flush=True)
    return row


def corrected_by(case: RealCase, folder: Path, name: str) -> Path | None:
    """The model file that an earlier case of the table has corrected, where a case is judged against that."""
    if case.after is None:
        return None
    path = folder / case.after / CORRECTED / MODEL
    if not path.is_file():
        expected = "the name of an earlier case with a corrected model"
        do = "correct the name, or put that case before"
        raise InputError(f"robots.cases.{name}.after", case.after, expected, do)
    return path
