import json

import pytest

from leapgap.errors import InputError
from leapgap.jumping.planning.reference import metrics, read_targets, timing, write_references
from leapgap.jumping.task import JointGains, Target, target_of
from leapgap.logs.log import read_log


def test_index_lists_the_references_in_order(solutions, tmp_path):
    chosen = [solutions["h20_d60"], solutions["h00_d40"]]
    write_references(chosen, tmp_path, JointGains(kp_nm_per_rad=80.0))
    index = json.loads((tmp_path / "references.json").read_text())
    assert [(row["x_m"], row["z_m"], row["file"]) for row in index] == [
        (0.6, 0.2, "h20_d60.parquet"),
        (0.4, 0.0, "h00_d40.parquet"),
    ]
    assert all(set(row) == {"x_m", "z_m", "cost", "max_violation", "status", "file"} for row in index)
    jump = read_log(tmp_path / index[0]["file"])
    assert target_of(jump) == Target(0.6, 0.2)
    assert set(jump["cmd_kp/FR_hip"]) == {80.0}


def test_metrics_and_timing_are_by_reference(solutions):
    chosen = [solutions["h00_d60"]]
    assert metrics(chosen)["cost"]["h00_d60"] == pytest.approx(4983.1, abs=0.05)
    assert 0 < metrics(chosen)["max_violation"] <= 1e-6
    assert timing(chosen)["seconds"]["h00_d60"] > 0


@pytest.mark.parametrize(
    "pairs",
    [
        None,
        5,
        "0.5,0",
        [],
        [0.5, 0.0],
        [[0.5]],
        [[0.5, "a"]],
        [[0.5, float("nan")]],
        [[0.5, True]],
        [[0.5, 0.0, 0.0]],
    ],
)
def test_what_is_no_list_of_targets_is_refused(pairs):
    with pytest.raises(InputError, match=r"optimize\.targets"):
        read_targets(pairs, "optimize.targets")


def test_whole_numbers_are_targets_too():
    assert read_targets([[1, 0], [0.5, 0.1]], "optimize.targets") == [Target(1.0, 0.0), Target(0.5, 0.1)]
