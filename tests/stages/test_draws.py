"""Draws of landings put together, from tables written by hand."""

from pathlib import Path

import pytest

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import write_json
from stages import draws

HEAD = "hardware,robot,method,task,number,jump,error_cm,pitch_deg,success,disturbance\n"
RUNS = {
    11: [
        "soft,soft,ours,jump_40,0,0,0.5,-3.0,True,",
        "soft,soft,ours,push_60,0,0,-2.0,4.0,True,+0.2 m/s at 0.3 s",
        "soft,soft,ours,push_60,1,0,4.0,-16.0,False,-0.2 m/s at 0.3 s",
        "random,random_5,ours,push_60,0,0,1.0,1.0,True,+45.5 N from 0.3 to 0.4 s",
    ],
    12: ["soft,soft,ours,jump_40,0,0,-1.5,2.0,True,", "soft,soft,ours,push_60,0,0,1.0,1.0,True,+0.2 m/s at 0.3 s"],
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for seed, rows in RUNS.items():
        (tmp_path / str(seed)).mkdir()
        (tmp_path / f"{seed}/landings.csv").write_text(HEAD + "\n".join(rows) + "\n")
        write_json(tmp_path / f"{seed}/landing.json", {"seed": seed})
    return tmp_path


def test_draws_are_figures_by_robot_method_seed_and_task(folder: Path) -> None:
    found = draws.merge(draws.rows_of_draws(folder))
    soft = found["robots"]["soft"]["ours"]
    assert soft["seed_11"]["abs_error_cm"] == {"jump_40": 0.5, "push_60": 3.0}
    assert soft["seed_11"]["worst_pitch_deg"]["push_60"] == 16.0
    assert soft["seed_11"]["success"]["push_60"] == 0.5
    assert list(found["robots"]) == ["soft", "random:5"]


def test_disturbances_of_one_kind_are_one_whatever_their_sign_and_draw(folder: Path) -> None:
    found = draws.merge(draws.rows_of_draws(folder))["disturbances"]
    assert found["m/s at 0.3 s"]["ours"]["soft"] == {"abs_error_cm": 2.333, "jumps": 3}
    assert found["N from 0.3 to 0.4 s"]["ours"]["random:5"]["jumps"] == 1


def test_the_table_has_means_over_draws_with_their_range(folder: Path) -> None:
    text = draws.tables(draws.merge(draws.rows_of_draws(folder)))
    assert "| `soft`: ours | 2 | 1.00 | 1.0 | 2.0 (1.0–3.0) | 16° |" in text


def test_a_folder_without_landings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no landings\.csv"):
        draws.rows_of_draws(tmp_path)
