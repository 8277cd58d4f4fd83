"""``dvc repro`` with one line that says what is running, how many stages are done and left, and for how long still.

The line is drawn on a terminal only; elsewhere DVC prints as ever. How long each stage took is kept in ``.dvc/tmp`` of
this machine; before a stage has run here, the time is that of ``metrics/timing/stages.json``.

Examples:

    python -m stages.repro
    python -m stages.repro evaluate
"""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import yaml
from omegaconf import OmegaConf

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import read_json, write_json
from stages.common import LONGEST_MESSAGE, program, read_params, run_command

RECORDED = Path("metrics/timing/stages.json")  # seconds of each stage as committed, measured on an idle machine
OWN = Path(".dvc/tmp/stage_seconds.json")  # seconds of each stage on this machine
BEGINS = re.compile(r"Running stage '([^']+)'")
ENDS = re.compile(r"Stage '([^']+)' (?:didn't change|is cached)")
PUBLISHED, RAW = Path("published/dvc.yaml"), Path("data/raw")
"""The pipeline of published jumps, and where their logs are."""
REDRAWN_EVERY_S = 1.0
CLEAR = "\r\x1b[K"  # moves to the start of the terminal's line and empties it


@dataclass
class Progress:
    """Which stages are done, which is running, and how long the others take."""

    stages: tuple[str, ...]
    seconds: Mapping[str, float]  # known durations by stage, s
    clock: Callable[[], float] = time.monotonic
    done: set[str] = field(default_factory=set)
    running: str | None = None
    began: float = 0.0
    taken: dict[str, float] = field(default_factory=dict)  # durations measured in this run, s

    def read(self, line: str) -> None:
        """Take note of a line of DVC's output."""
        if begins := BEGINS.search(line):
            self.finish()
            self.running, self.began = begins[1], self.clock()
        elif ends := ENDS.search(line):
            if ends[1] != self.running:
                self.finish()
            self.running = None  # restored from the cache: its duration says nothing
            self.done.add(ends[1])

    def finish(self) -> None:
        """The running stage has ended."""
        if self.running is not None:
            self.taken[self.running] = self.clock() - self.began
            self.done.add(self.running)
        self.running = None

    @property
    def left(self) -> list[str]:
        """Stages that are neither done nor running."""
        return [name for name in self.stages if name not in self.done and name != self.running]

    @property
    def seconds_left(self) -> float | None:
        """Time that the rest takes if all of it runs, s; None where no stage of it has a known duration."""
        known = [self.seconds[name] for name in self.left if name in self.seconds]
        if self.running is not None and self.running in self.seconds:
            known.append(max(0.0, self.seconds[self.running] - (self.clock() - self.began)))
        return sum(known) if known else None

    @property
    def line(self) -> str:
        """``train@published for 12 s · 7 done, 33 left · at most 5 min``."""
        here = f"{self.running} for {in_words(self.clock() - self.began)}" if self.running else "between stages"
        rest = self.seconds_left
        eta = "" if rest is None else f" · at most {in_words(rest)}"
        return f"{here} · {len(self.done)} done, {len(self.left)} left{eta}"


def in_words(seconds: float) -> str:
    """``45 s``, ``6 min`` or ``1 h 20 min``."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def stage_names(dvc_yaml: Path) -> tuple[str, ...]:
    """Names of all stages as DVC prints them, ``train@damped`` for each entry of a ``foreach``, in the file's order.

    ``InputError`` for a file that is not there or states no stages.
    """
    if not dvc_yaml.is_file():
        raise InputError(dvc_yaml, "no such file", "the stages of a pipeline", "run it in the project's folder")
    above = "" if dvc_yaml.parent == Path() or dvc_yaml.is_absolute() else f"{dvc_yaml.as_posix()}:"
    text = dvc_yaml.read_text(encoding="utf-8", errors="replace")
    names: list[str] = []
    try:
        stages: dict[str, Any] = yaml.safe_load(text)["stages"]
        for name, stage in stages.items():
            runs = entries(stage["foreach"]) if "foreach" in stage else None
            names += [f"{above}{name}"] if runs is None else [f"{above}{name}@{key}" for key in runs]
    except (yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        says = " ".join(str(error).split())[:LONGEST_MESSAGE]
        raise InputError(dvc_yaml, f"no stages ({says})", "the stages of a pipeline", "see: dvc stage list") from None
    return tuple(names)


def entries(foreach: Any) -> list[str]:
    """Keys of a ``foreach``, which may name a section of params.yaml: ``${variants.train}``."""
    if isinstance(foreach, str):
        foreach = OmegaConf.select(read_params(), foreach.strip("${} "))
    return [str(key) for key in foreach]


def has_published(raw: Path) -> bool:
    """Whether somebody else's logs are there: any file that is not this project's own."""
    ours = {"README.md", ".gitignore"}
    return raw.is_dir() and any(path.is_file() and path.name not in ours for path in raw.rglob("*"))


def known_seconds() -> dict[str, float]:
    """Durations by stage: as committed, and in their place those of this machine, s."""
    found: dict[str, float] = {}
    for path in (RECORDED, OWN):
        if path.is_file():
            found |= read_json(path)
    return found


def follow(output: Iterable[str], progress: Progress, screen: TextIO, lines: bool) -> None:
    """Pass DVC's output on; with ``lines``, keep the line of progress below it."""
    lock, over = threading.Lock(), threading.Event()

    def draw() -> None:
        if lines:
            width = os.get_terminal_size(screen.fileno()).columns if screen.isatty() else 120
            screen.write(f"{CLEAR}{progress.line[: width - 1]}")
            screen.flush()

    def redraw() -> None:
        while not over.wait(REDRAWN_EVERY_S):
            with lock:
                draw()

    drawer = threading.Thread(target=redraw, daemon=True)
    drawer.start()
    for line in output:
        with lock:
            progress.read(line)
            screen.write(f"{CLEAR if lines else ''}{line}")
            screen.flush()
            draw()
    over.set()
    drawer.join()
    if lines:
        screen.write(CLEAR)
        screen.flush()


def repro(arguments: list[str], screen: TextIO = sys.stdout) -> int:
    """Run ``dvc repro`` with these arguments; its exit code.

    Without any, all that can be made here is: the pipeline of published jumps too, where there are logs of them.
    """
    pipelines = [Path("dvc.yaml"), *([PUBLISHED] if has_published(RAW) else [])]
    if not arguments:
        arguments = [path.as_posix() for path in pipelines]
    progress = Progress(tuple(name for path in pipelines for name in stage_names(path)), known_seconds())
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen([program("dvc"), "repro", *arguments], text=True, env=environment, **pipes) as dvc:  # type: ignore[call-overload]
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to DVC too, which ends and says so
        follow(dvc.stdout, progress, screen, screen.isatty())
    if dvc.returncode == 0:
        progress.finish()
    if progress.taken:
        OWN.parent.mkdir(parents=True, exist_ok=True)
        write_json(OWN, known_seconds() | {name: round(value, 1) for name, value in progress.taken.items()})
    return dvc.returncode


if __name__ == "__main__":
    run_command("repro", repro)
