"""What each threshold of a diagnosis decides: withheld cases are judged with thresholds that watch their comparisons.

One diagnosis of a case tells for every threshold by which factor it would have to change for the first comparison to
end otherwise. Where none of the cases has one between 1/1.5 and 1.5, the threshold may be half as large again, or two
thirds, and no verdict changes. Cases with such a comparison are judged again with the threshold changed, so that the
table says in how many of them the answer changes too, and whether it gets better by what is sealed. Run as
``python -m tests.benchmarks.sensitivity --logs data/blind/logs --truth data/blind/truth --json <file>``; the cases are
those of the half ``tuning``, and ``--only ur5e`` takes those whose name begins so. A case takes half a minute, and each
changed threshold as much again. A threshold that is used and not compared (``model_error``) is not in the table.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.reports.diagnosis import diagnose_folder
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json
from tests.benchmarks import run_benchmark
from tests.benchmarks.diagnose import tiny

FACTOR = 1.5
"""Thresholds are changed by this factor, up and down."""
SHARES_FROM = 0.6
"""A threshold between this and one is a share; a larger factor would make it impossible to reach."""
NO_THRESHOLDS = ("horizon_s", "every_s", "where_horizon_s")
"""Numbers of the settings that are lengths of replays."""


class Watched(np.float64):
    """A threshold, or a sum or product of one, that keeps what it is compared with.

    Its value is ``offset + slope · threshold``. Arrays leave operations with it to it.
    """

    __array_ufunc__ = None
    name: str
    seen: dict[str, list[float]]
    threshold: float
    offset: float
    slope: float

    @classmethod
    def of(
        cls, name: str, seen: dict[str, list[float]], threshold: float, offset: float = 0.0, slope: float = 1.0
    ) -> "Watched":
        """The number that depends so on a threshold."""
        found = cls(offset + slope * threshold)
        found.name, found.seen, found.threshold, found.offset, found.slope = name, seen, threshold, offset, slope
        return found

    def plain(self) -> float:
        """The number without what it keeps, for operations that nothing is to be noted of."""
        return float(np.float64(self))

    def linear(self, offset: float, slope: float) -> "Watched":
        """This number times ``slope`` and ``offset`` added."""
        return Watched.of(self.name, self.seen, self.threshold, offset + slope * self.offset, slope * self.slope)

    def note(self, other: Any) -> Any:
        """Keep the factors on the threshold at which comparisons with ``other`` end otherwise; ``other``, plain."""
        plain = other.plain() if isinstance(other, Watched) else other
        if self.slope and self.threshold:
            factors = (np.atleast_1d(np.asarray(plain, float)) - self.offset) / self.slope / self.threshold
            self.seen.setdefault(self.name, []).extend(factors[np.isfinite(factors)].tolist())
        return plain

    def __lt__(self, other: Any) -> Any:
        return self.plain() < self.note(other)

    def __le__(self, other: Any) -> Any:
        return self.plain() <= self.note(other)

    def __gt__(self, other: Any) -> Any:
        return self.plain() > self.note(other)

    def __ge__(self, other: Any) -> Any:
        return self.plain() >= self.note(other)

    def __neg__(self) -> "Watched":
        return self.linear(0.0, -1.0)

    def __add__(self, other: Any) -> Any:
        return self.linear(float(other), 1.0) if np.ndim(other) == 0 else other + self.plain()

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __sub__(self, other: Any) -> Any:
        return self.linear(-float(other), 1.0) if np.ndim(other) == 0 else self.plain() - other

    def __rsub__(self, other: Any) -> Any:
        return self.linear(float(other), -1.0) if np.ndim(other) == 0 else other - self.plain()

    def __mul__(self, other: Any) -> Any:
        return self.linear(0.0, float(other)) if np.ndim(other) == 0 else other * self.plain()

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __truediv__(self, other: Any) -> Any:
        return self.linear(0.0, 1 / float(other)) if np.ndim(other) == 0 else self.plain() / other

    def __rtruediv__(self, other: Any) -> Any:
        return other / self.plain()

    def __hash__(self) -> int:
        return hash(self.plain())

    def __deepcopy__(self, memo: Any) -> float:
        return self.plain()


def thresholds(settings: Settings) -> Iterator[tuple[str, float]]:
    """Names and values of the thresholds: numbers of the settings with a fraction, but for lengths of replays."""
    for field in fields(settings):
        value = getattr(settings, field.name)
        if is_dataclass(value):
            own = ((f"{field.name}.{one.name}", getattr(value, one.name)) for one in fields(value))
            yield from ((name, number) for name, number in own if isinstance(number, float))
        elif isinstance(value, float) and field.name not in NO_THRESHOLDS:
            yield field.name, value


def with_threshold(settings: Settings, name: str, value: float) -> Settings:
    """The settings with another value of a threshold."""
    section, _, own = name.rpartition(".")
    if not section:
        return replace(settings, **{own: value})
    return replace(settings, **{section: replace(getattr(settings, section), **{own: value})})


@dataclass(frozen=True)
class Case:
    """A withheld case with what is sealed."""

    name: str
    folder: Path
    robot: Path
    true: frozenset[str]
    """Effects that act; one that the diagnosis has no name for is never in an answer."""

    def answer(self, settings: Settings) -> tuple[str, frozenset[str]]:
        """Verdict and first names of its causes."""
        found = diagnose_folder(self.folder, Robot.load(self.robot), settings)
        if found is None:
            raise InputError(self.folder, "no logs", "withheld logs", "run stages.withhold first")
        return found.verdict, frozenset(names[0] for names in found.content.answer)


def cases(logs: Path, truth: Path, robot: Path, only: str, halves: Sequence[str]) -> list[Case]:
    """The cases of some halves whose name begins with ``only``."""
    found = []
    for folder in sorted(path for path in logs.glob(f"{only}*") if path.is_dir()):
        sealed = read_json(truth / f"{folder.name}.json")
        if sealed["half"] in halves:
            own = folder / "robot.xml"
            true = frozenset(one["name"] for one in sealed["effects"])
            found.append(Case(folder.name, folder, own if own.exists() else robot, true))
    return found


def watch(case: Case, settings: Settings) -> tuple[tuple[str, frozenset[str]], dict[str, list[float]]]:
    """The answer on a case, and by threshold the factors at which comparisons end otherwise."""
    seen: dict[str, list[float]] = {}
    watched = settings
    for name, value in thresholds(settings):
        watched = with_threshold(watched, name, Watched.of(name, seen, value))
    seen.clear()  # the checks of the settings themselves
    return case.answer(watched), seen


def changed(value: float, by: float) -> float:
    """A threshold changed by a factor; of a share near one, what it lacks of one is changed instead."""
    return 1 - (1 - value) / by if SHARES_FROM <= value < 1 and by > 1 else value * by


def flips(factors: Sequence[float], by: float) -> bool:
    """Whether a comparison ends otherwise with a threshold changed by a factor."""
    low, high = sorted((1.0, by))
    return any(low < factor < high for factor in factors)


def better(case: Case, before: frozenset[str], after: frozenset[str]) -> int:
    """How many more effects of an answer are right or fewer wrong; negative where it is worse."""
    return (len(after & case.true) - len(after - case.true)) - (len(before & case.true) - len(before - case.true))


def row_name(name: str, by: float) -> str:
    """A threshold with the change that a row is of."""
    return f"{name} {'×' if by > 1 else '/'} {FACTOR:g}"


def table(chosen: Sequence[Case], settings: Settings, begins: str = "") -> dict[str, dict[str, Any]]:
    """By threshold and direction: cases that compare it, that do so with another end, and that have another answer.

    ``better`` counts the right effects that other answers have more and the wrong ones that they have fewer. Thresholds
    are those whose names begin with ``begins``.
    """
    judged = [one for one in thresholds(settings) if one[0].startswith(begins)]
    found: dict[str, dict[str, Any]] = {
        row_name(name, by): {"value": value, "compared": 0, "closer": 0, "other": [], "better": 0}
        for name, value in judged
        for by in (FACTOR, 1 / FACTOR)
    }
    for case in chosen:
        before, seen = watch(case, settings)
        print(f"{case.name}: {before[0]} {', '.join(sorted(before[1]))}", flush=True)
        for name, value in judged:
            for by in (FACTOR, 1 / FACTOR):
                row = found[row_name(name, by)]
                row["compared"] += name in seen
                if not flips(seen.get(name, []), changed(value, by) / value):
                    continue
                row["closer"] += 1
                after = case.answer(with_threshold(settings, name, changed(value, by)))
                if after != before:
                    row["other"].append(case.name)
                    row["better"] += better(case, before[1], after[1])
                    print(f"  {name} {changed(value, by):.3g}: {after[0]} {', '.join(sorted(after[1]))}", flush=True)
    return found


def main() -> None:
    """Judge the cases and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=Path, default=Path("data/withheld/logs"))
    parser.add_argument("--truth", type=Path, default=Path("data/withheld/truth"))
    parser.add_argument("--robot", type=Path, default=Robot.load().path)
    parser.add_argument("--only", default="", help="beginning of the names of the cases")
    parser.add_argument("--most", type=int, default=None, help="number of cases")
    parser.add_argument("--tiny", action="store_true", help="one case of any half, few thresholds, to see that it runs")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    settings = replace(Settings(), best=False)
    halves = ("tuning", "reported") if chosen.tiny else ("tuning",)
    found = cases(chosen.logs, chosen.truth, chosen.robot, chosen.only, halves)[: 1 if chosen.tiny else chosen.most]
    if not found:
        raise InputError(chosen.logs, "no case of the half tuning", "withheld cases", "run make blind first")
    rows = table(found, tiny(settings), "outside.least_size") if chosen.tiny else table(found, settings)
    if chosen.json:
        write_json(chosen.json, {"cases": [case.name for case in found], "thresholds": rows})


if __name__ == "__main__":
    run_benchmark(main)
