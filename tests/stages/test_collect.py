"""What collect prints of a jump."""

import pytest

from leapgap.jumping.experiments.collecting import landing_in_words


@pytest.mark.parametrize(
    ("error_cm", "words"),
    [
        (13.72, "13.7 cm short"),
        (-13.72, "13.7 cm too far"),
        (0.04, "on target"),
        (-0.04, "on target"),
        (-0.05000001, "0.1 cm too far"),
    ],
)
def test_a_landing_is_short_or_too_far_and_never_negative(error_cm: float, words: str) -> None:
    assert landing_in_words(error_cm) == words
