"""The same input gives the same bytes, whatever the number of threads and processes."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import leapgap as lg
from leapgap.reports import diagnosis
from leapgap.runtime.blas import loaded, one_blas_thread
from tests import plain_arm
from tests.commands import python

SUMS = """
import hashlib
import numpy, scipy.linalg
{before}
matrix = numpy.random.default_rng(1).normal(size=(3000, 257))
sums = (matrix.T @ matrix, scipy.linalg.lstsq(matrix, matrix[:, 0] ** 2)[0])
print(hashlib.sha256(b"".join(numpy.ascontiguousarray(one).tobytes() for one in sums)).hexdigest())
"""
PINNED = "from leapgap.runtime.blas import one_blas_thread; pin = one_blas_thread(); pin.__enter__()"


def with_threads(number: int, before: str) -> str:
    """What a process with that many threads of BLAS prints."""
    threads = {f"{library}_NUM_THREADS": str(number) for library in ("OMP", "OPENBLAS", "MKL")}
    done = python("-c", SUMS.format(before=before), **threads)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core has one thread")
def test_one_thread_makes_sums_independent_of_the_cores() -> None:
    assert with_threads(1, "") != with_threads(2, ""), "BLAS adds up alike; the test shows nothing"
    assert with_threads(1, PINNED) == with_threads(2, PINNED)


def test_the_number_of_threads_is_given_back() -> None:
    before = [one.get() for one in loaded()]
    assert before, "NumPy and SciPy use no OpenBLAS that is known"
    with one_blas_thread():
        assert {one.get() for one in loaded()} == {1}
    assert [one.get() for one in loaded()] == before


def test_a_diagnosis_computes_with_one_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From Python, where no variable of the environment can be set any more."""
    plain_arm.write_model(tmp_path)
    plain_arm.write_parquet(tmp_path / "logs")
    seen: list[set[int]] = []

    def stop(*_: Any, **__: Mapping[str, Any]) -> None:
        seen.append({one.get() for one in loaded()})
        raise RuntimeError

    monkeypatch.setattr(diagnosis, "diagnose", stop)
    for one in loaded():
        one.set(2)
    try:
        with pytest.raises(RuntimeError):
            lg.diagnose(tmp_path / "logs", tmp_path / "arm.xml")
        assert {one.get() for one in loaded()} == {2}
    finally:
        for one in loaded():
            one.set(1)
    assert seen == [{1}]


def test_stages_use_one_thread_whatever_the_environment_says() -> None:
    code = "import stages, os; print(os.environ['OMP_NUM_THREADS'], os.environ['OPENBLAS_NUM_THREADS'])"
    assert python("-c", code, OMP_NUM_THREADS="4", OPENBLAS_NUM_THREADS="4").stdout == "1 1\n"
