"""Blocks of code in Markdown pages: found, and run as a reader would run them.

Python blocks of one page share a namespace. Shell blocks stop at their first command that fails. A fence without a
language is a shell block if its first word is a known command. A block is left out only by a comment before it that
says why::

    <!-- not run: needs network -->

A block with the tag ``output`` is what the blocks before it on its page have printed. Lines may be left out of it and
broken elsewhere. Numbers may differ by 10 %, or by one in the last digit that the page shows: more is a stale page.
"""

import contextlib
import io
import re
import signal
import subprocess
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

PYTHON = ("python", "py")
SHELL = ("bash", "sh", "shell", "console")
OUTPUT = "output"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
NEAR = 0.1
"""Share by which a printed number may differ from that of the page."""
COMMANDS = ("dvc", "git", "leapgap", "make", "mkdocs", "pip", "pytest", "python", "python3", "rerun")
FENCE = re.compile(r"(?P<indent>[ \t]*)(?P<fence>`{3,}|~{3,})\s*(?:\{\s*\.)?(?P<language>[\w+-]*)")
NOT_RUN = re.compile(r"\s*<!--\s*not run:(?P<reason>.*?)-->\s*")
SECONDS, CORES = 300, 2
"""A block that takes longer than a reader would wait, on so many cores, has failed: told by the processor's time, since
other tests run beside it."""
HANGS = 3
"""Times as long by the clock: a block that does nothing."""
TOO_LONG = (-signal.SIGXCPU, 128 + signal.SIGXCPU)
"""What bash ends with after a command that has had all its time: in its place, or started by it."""


class BlockError(Exception):
    """A block that failed, with its place and what it printed."""


@dataclass(frozen=True)
class Block:
    """A fenced block; ``language`` is ``python``, ``shell``, ``output`` or, for anything else, empty."""

    page: str
    line: int
    """Of the opening fence, from 1."""
    language: str
    code: str
    not_run: str | None = None
    """Why the block is left out."""

    @property
    def place(self) -> str:
        """Page and line, as editors open them."""
        return f"{self.page}:{self.line}"


def language_of(tag: str, code: str) -> str:
    """The language of a fence with this tag: ``python``, ``shell``, ``output`` or empty."""
    if tag.lower() in PYTHON:
        return "python"
    if tag.lower() == OUTPUT:
        return OUTPUT
    words = code.split()
    if tag.lower() in SHELL or (not tag and words and words[0] in COMMANDS):
        return "shell"
    return ""


def blocks(page: str, text: str) -> Iterator[Block]:
    """Blocks of a page in order, those of no language that runs left out.

    Raises:
        BlockError: a fence that is not closed, or a mark ``not run`` without a reason or without a block.
    """
    opening: Block | None = None
    indent, fence, tag = "", "", ""
    code: list[str] = []
    mark: tuple[int, str] | None = None
    for number, line in enumerate(text.splitlines(), 1):
        matched = FENCE.match(line)
        if opening is not None:
            closing = matched and matched["fence"].startswith(fence) and not line.strip().strip(fence[0])
            if not closing:
                code.append(line.removeprefix(indent))
                continue
            body = "\n".join(code) + "\n"
            complete = replace(opening, code=body, language=language_of(tag, body))
            opening = None
            if complete.language:
                yield complete
            elif complete.not_run:
                raise BlockError(f"{complete.place}: marked 'not run', but no block of Python or shell")
        elif matched:
            indent, fence, tag = matched["indent"], matched["fence"], matched["language"]
            opening, code = Block(page, number, "", "", mark[1] if mark else None), []
            mark = None
        elif found := NOT_RUN.fullmatch(line):
            if not found["reason"].strip():
                raise BlockError(f"{page}:{number}: 'not run' says no reason")
            mark = number, found["reason"].strip()
        elif line.strip() and mark:
            raise BlockError(f"{page}:{mark[0]}: 'not run' stands before no block")
    if opening is not None:
        raise BlockError(f"{opening.place}: fence is not closed")
    if mark:
        raise BlockError(f"{page}:{mark[0]}: 'not run' stands before no block")


def run_page(page: str, text: str, folder: Path, environment: dict[str, str]) -> list[Block]:
    """Run the blocks of a page in order in ``folder``; returns those that ran.

    Raises:
        BlockError: the first block that fails, with its place and its output, or that shows what was not printed.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    ran, printed = [], ""
    for block in blocks(page, text):
        if block.not_run:
            continue
        if block.language == OUTPUT:
            check_printed(block, printed)
            continue
        printed += (
            run_python(block, names, folder) if block.language == "python" else run_shell(block, folder, environment)
        )
        ran.append(block)
    return ran


def check_printed(block: Block, printed: str) -> None:
    """Raise ``BlockError`` where a line of a block of output was not printed, line breaks and near numbers aside."""
    said = in_one_line(printed)
    for line in filter(None, map(in_one_line, block.code.splitlines())):
        shown = NUMBER.findall(line)
        words = NUMBER.pattern.join(map(re.escape, NUMBER.split(line)))
        found = [NUMBER.findall(one) for one in re.findall(words, said)]
        if not any(all(map(is_near, shown, numbers)) for numbers in found):
            others = "; ".join(dict.fromkeys(" ".join(numbers) for numbers in found))
            but = f", but with the numbers {others}" if found else ""
            raise BlockError(f"{block.place}: no block before it has printed {line!r}{but}\n{printed[-4000:]}")


def in_one_line(text: str) -> str:
    """A text with single spaces in place of line breaks and indents."""
    return " ".join(text.split())


def is_near(shown: str, printed: str) -> bool:
    """Whether a printed number is that of the page, to ``NEAR`` of it or to one in its last digit."""
    last = 0.0 if "e" in shown else 10.0 ** -len(shown.partition(".")[2])
    away = abs(float(shown) - float(printed))
    return away <= max(NEAR * abs(float(shown)), 1.001 * last)


def run_python(block: Block, names: dict[str, Any], folder: Path) -> str:
    """Run in this process and return what was printed; lines of a traceback are those of the page."""
    padded = "\n" * block.line + block.code
    printed = io.StringIO()
    try:
        with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
            exec(compile(padded, block.page, "exec"), names)
    except Exception:
        raise BlockError(f"{block.place}: python block failed\n{printed.getvalue()}{traceback.format_exc()}") from None
    return printed.getvalue()


def run_shell(
    block: Block, folder: Path, environment: dict[str, str], seconds: float = SECONDS, hangs: float = HANGS
) -> str:
    """Run by bash, stopping at the first command that fails, and return what was printed.

    It may take so many ``seconds`` of all cores, and as many times that by the clock as ``hangs`` says.
    """
    limited = f"ulimit -S -t {round(CORES * seconds)}\n{block.code}"
    try:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", limited],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=hangs * seconds,
        )
    except subprocess.TimeoutExpired:
        raise BlockError(f"{block.place}: shell block hangs: not done in {hangs * seconds} s") from None
    if done.returncode in TOO_LONG:
        raise BlockError(f"{block.place}: shell block takes longer than {seconds} s on {CORES} cores")
    if done.returncode != 0:
        output = (done.stdout + done.stderr)[-4000:]
        raise BlockError(f"{block.place}: shell block ended with code {done.returncode}\n{output}")
    return done.stdout + done.stderr
