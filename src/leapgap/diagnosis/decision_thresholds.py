"""Thresholds of the decision."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DecisionThresholds:
    """Thresholds of the decision."""

    rival_share: float = 0.05
    """A rival that is best in this share of the resamples cannot be separated."""
    most_left: float = 1.3
    """Largest mean over segments of χ² over its expectation at which noise explains the rest of short replays.

    Where it leaves more, it must explain ``enough_closure`` of the headline gap on held-out logs, or
    ``least_closure`` of it and explain ``least_explained`` of the log likelihood that noise does not.
    """
    least_explained: float = 0.8
    enough_closure: float = 0.7
    least_closure: float = 0.35
    enough_jointly: float = 0.9
    """An answer with a number at the end of its range is ``partly`` unless it explains so much."""
    partly_closure: float = 0.2
    """Causes that are likely and explain too little are called ``partly`` where they explain this share of the
    headline gap on held-out logs, with an interval above zero."""
    most_whole_gap: float = 5.0
    """Largest gap of whole logs, in noise floors, of which a named answer may explain less than ``partly_closure``. Of
    396 sealed cases right answers that explained so little had 2.7 and less; one for an unmodelled cause had 11."""
    most_worsened: float = 0.02
    """An answer that widens the headline gap on held-out logs by a larger share explains nothing; a rival must close
    this share more than the answer."""
    least_sure: float = 0.9
    """A rival that is better on whole logs of a held robot in so many resamples may be as likely as the answer."""
    none_below: float = 1.15
    """Largest median of χ² over its expectation at which noise explains short replays of the nominal robot."""
    none_gap: float = 2.7
    """Largest gap of full rollouts, in noise floors, that noise and tolerances of the model explain."""
    none_gain: float = 40.0
    """A cause that closes little of a gap within noise is none where it gains less in short replays."""
