"""Seals: a truth is published as a salted hash before any verdict, and must match it when it is opened."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import read_json, sha256

SEALS = "seals.json"  # file beside the logs: case → seal of its truth
PUBLISHED = "published"  # name of the case of published jumps; it may be known, since their columns differ anyway


def seal(truth: Mapping[str, Any]) -> str:
    """SHA-256, in hex, over the truth as canonical JSON; its random ``salt`` prevents guessing."""
    if not truth.get("salt"):
        raise InputError("truth", "no salt", "a truth with a salt", "withhold the case again")
    return hashlib.sha256(json.dumps(truth, sort_keys=True, allow_nan=False).encode()).hexdigest()


def open_truth(folder: Path, logs: Path, case: str) -> Mapping[str, Any]:
    """Read the truth of a case and check its seal.

    ``InputError`` where the truth, one of the case's logs, or the model of its own robot is not the one that was
    sealed.
    """
    path = folder / f"{case}.json"
    truth = read_json(path)
    published = read_json(logs / SEALS).get(case)
    if published is None or seal(truth) != published:
        expected = f"the seal {str(published)[:12]}… that was published with the logs"
        do = "the truth was changed after it was sealed: withhold and diagnose the cases again"
        raise InputError(path, f"a truth with the seal {seal(truth)[:12]}…", expected, do)
    check_files(truth["logs"], logs / case)
    check_files(truth.get("model", {}), logs / case)
    check_files(truth["proof"], folder / case)
    return truth


def check_files(expected: Mapping[str, str], folder: Path) -> None:
    """Refuse a file whose bytes are not those that were sealed."""
    for name, digest in expected.items():
        path = folder / name
        found = sha256(path) if path.is_file() else "no file"
        if found != digest:
            raise InputError(
                path, f"{found[:12]}…", f"the sealed file {digest[:12]}…", "withhold and diagnose the cases again"
            )
