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
    """Where the answer of a search one by one leaves more than noise and tolerances, all effects are fitted together.
    They explain the whole gap where they close so much of it; 0: they are never fitted."""
    most_left_named: float = 5.0
    """Largest median over short segments of χ² over its expectation, with tolerances fitted, that a cause may leave
    which explains less than ``enough_jointly``. Right causes left 1.0 to 1.1, one that stood for another 28."""
    least_known: float = 7.5
    """Of several causes each differs from nominal by so many standard deviations of its fit, but the best known one.
    Among 150 sealed cases the 56 causes of such answers that acted had 8.2 and more, and 15 of the 23 that did not had
    7.2 and less."""
    least_known_named: float = 15.0
    """Several causes that close less than ``enough_jointly`` are ``named`` only where each number differs from nominal
    by so many standard deviations. Of 198 sealed cases the seven such answers whose causes acted have 19 and more,
    one with a cause too many has 13, and three that stand for a cause that was struck have 8.1 to 11.8."""
    partly_closure: float = 0.2
    """Causes that are likely and explain too little are called ``partly`` where they explain this share of the
    headline gap on held-out logs, with an interval above zero."""
    most_whole_gap: float = 5.0
    """Largest gap of whole logs, in noise floors, of which a named answer may explain less than ``partly_closure``. Of
    396 sealed cases right answers that explained so little had 2.7 and less; one for an unmodelled cause had 11."""
    most_worsened: float = 0.02
    """A further cause that widens the headline gap on held-out logs by a larger share is rejected, whatever it gains in
    short replays."""
    least_shrunk: float = 0.05
    """A held robot neither lands nor falls: what short replays say must show in whole logs. A further cause must shrink
    the gap that the causes before it leave by this share, and no answer may significantly widen the nominal robot's."""
    least_sure: float = 0.9
    """A rival that is better on whole logs of a held robot in so many resamples may be as likely as the answer."""
    none_below: float = 1.15
    """Largest median of χ² over its expectation at which noise explains short replays of the nominal robot."""
    none_gap: float = 2.7
    """Largest gap of full rollouts, in noise floors, that noise and tolerances of the model explain."""
    none_gain: float = 40.0
    """Causes that close little of a gap within noise are none where they gain less in short replays."""
