"""Committed figures have no digits that differ from one processor to the next."""

from pathlib import Path

import numpy as np
import pytest

from leapgap.runtime.atomic_io import read_json, write_metrics


def test_figures_that_differ_in_their_last_bits_are_the_same_file(tmp_path: Path) -> None:
    first = {"error_cm": {"a": 3.853809956209464}, "rounds": [np.float64(1583.9858619337426), 7, None, True, "named"]}
    other = {"error_cm": {"a": 3.8538099562118178}, "rounds": (1583.985861933, 7, None, True, "named")}
    for name, figures in (("first", first), ("other", other)):
        write_metrics(tmp_path / f"{name}.json", figures)
    assert (tmp_path / "first.json").read_bytes() == (tmp_path / "other.json").read_bytes()
    assert read_json(tmp_path / "first.json") == {"error_cm": {"a": 3.854}, "rounds": [1584.0, 7, None, True, "named"]}


def test_a_figure_that_is_no_number_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_metrics(tmp_path / "m.json", {"a": float("nan")})
