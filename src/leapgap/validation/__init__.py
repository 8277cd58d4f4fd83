"""The benchmark: cases whose cause is withheld, sealed truths, and the score of verdicts. No diagnosis imports it."""
