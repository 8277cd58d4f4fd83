"""A robot that left its plan lately is told from one that has been off it for long."""

import numpy as np

from leapgap.jumping.control.deviation_recorder import DeviationHistory

UPDATES, PERIOD_S = 32, 0.025
OFF = np.array([0.004, -0.003, 0.01, 0.1, 0.2, 0.3, 0.005, 0.006, 0.007, 0.008])
POSTURE = OFF[[0, 1, 2, 6, 7, 8, 9]]
LEFT = np.array([0.002, 0.0, 0.0, 0.0, 0.0, 0.0, -0.004, 0.0, -0.004, 0.0])


def test_what_left_the_plan_lately_is_told_from_what_has_been_off_it_for_long() -> None:
    """Off from the beginning on, and farther from 0.4 s on: seen as lately until 0.45 s, as before from then on."""
    history = DeviationHistory(UPDATES, PERIOD_S)
    for update in range(20):
        found = history.at(update, OFF + LEFT * (update > 16))
        lately, before, turned = found[[0, 1, 2, 6, 7, 8, 9]], found[10:17], found[17:]
        left = LEFT[[0, 1, 2, 6, 7, 8, 9]]
        np.testing.assert_allclose(found[3:6], OFF[3:6])
        np.testing.assert_allclose(turned, POSTURE, err_msg=str(update))
        np.testing.assert_allclose(lately, left * (16 < update < 19), atol=1e-12, err_msg=str(update))
        np.testing.assert_allclose(before, left * (update >= 19), atol=1e-12, err_msg=str(update))


def test_the_way_to_the_plan_of_a_late_stance_is_no_move() -> None:
    """A robot that is centimetres off until its stance is measured, and on the plan at 0.1 s."""
    history = DeviationHistory(UPDATES, PERIOD_S)
    for update in range(8):
        found = history.at(update, OFF * (update < 4))
        np.testing.assert_allclose(found[[0, 1, 2, 6, 7, 8, 9, *range(10, 17)]], 0, atol=1e-12)
        np.testing.assert_allclose(found[17:], POSTURE * (update < 4))


def test_an_update_without_a_measurement_leaves_the_past_where_it_was() -> None:
    history = DeviationHistory(UPDATES, PERIOD_S)
    for update in range(14):
        history.at(update, OFF)
    assert not np.isfinite(history.at(14, np.full(10, np.nan))[:10]).any()
    found = history.at(16, OFF + LEFT)
    np.testing.assert_allclose(found[[0, 6, 8]], [0.002, -0.004, -0.004])
    np.testing.assert_allclose(found[17:], POSTURE)


def test_what_was_never_measured_counts_as_on_the_plan() -> None:
    found = DeviationHistory(UPDATES, PERIOD_S).at(20, OFF)
    np.testing.assert_allclose(found, [*OFF, *[0.0] * 14])
