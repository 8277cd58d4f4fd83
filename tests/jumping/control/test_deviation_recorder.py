"""Feet that stand elsewhere from the beginning on are told from feet that moved since."""

import numpy as np

from leapgap.jumping.control.deviation_recorder import FeetAtBeginning

PERIOD_S = 0.025
TRUNK = np.arange(6.0)


def test_until_150_ms_all_is_of_the_beginning_and_then_what_moved_is_told_apart() -> None:
    beginning = FeetAtBeginning(PERIOD_S)
    for update in range(7):
        feet = 0.001 * (update + np.arange(4.0))
        np.testing.assert_allclose(
            beginning.apart(update, np.append(TRUNK, feet)), [*TRUNK, 0, 0, 0, 0, *feet], atol=1e-15
        )
    slipped = np.append(TRUNK, [0.010, 0.007, 0.008, 0.009])  # 6 to 9 mm at the beginning
    found = beginning.apart(7, slipped)
    np.testing.assert_allclose(found, [*TRUNK, 0.004, 0, 0, 0, 0.006, 0.007, 0.008, 0.009], atol=1e-15)


def test_feet_that_were_not_measured_last_count_where_they_were_before() -> None:
    beginning = FeetAtBeginning(PERIOD_S)
    feet = np.array([0.001, 0.002, 0.003, 0.004])
    beginning.apart(3, np.append(TRUNK, feet))
    assert not np.isfinite(beginning.apart(6, np.append(TRUNK, np.full(4, np.nan)))[6:10]).any()
    np.testing.assert_allclose(beginning.apart(8, np.append(TRUNK, feet + 0.002))[6:], [*[0.002] * 4, *feet])


def test_feet_that_were_never_measured_at_the_beginning_are_taken_for_those_of_the_plan() -> None:
    found = FeetAtBeginning(PERIOD_S).apart(9, np.append(TRUNK, [0.001, 0.002, 0.003, 0.004]))
    np.testing.assert_allclose(found[6:], [0.001, 0.002, 0.003, 0.004, 0, 0, 0, 0])
