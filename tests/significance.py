"""Statistical assertions. Each fails by chance with a probability of at most ``LEVEL``, however much it compares."""

import numpy as np
from scipy import stats

LEVEL = 1e-4
"""Probability that one assertion fails although what it asserts is true."""
ROUNDING = 2e-6
"""Relative error that arithmetic in single precision is granted where nothing is random: some 16 units of 2^-23."""


def sidak(comparisons, level=LEVEL):
    """Level of each of several independent comparisons, so that all of them together keep the given one."""
    return -np.expm1(np.log1p(-level) / comparisons)


def summary(batches):
    """Mean of independent batches along the first axis, variance of that mean, degrees of freedom."""
    batches = np.asarray(batches, dtype=np.float64)
    count = len(batches)
    assert count >= 32, "too few batches to know the standard error"
    return batches.mean(0), batches.var(0, ddof=1) / count, count - 1


def assert_same_mean(first, second, level=LEVEL):
    """Two-sided tests that two sets of independent batches have equal means, element by element.

    The standard errors are estimated from the batches, so the statistic is Welch's: a z-score whose tails are those of
    Student's t with the degrees of freedom of Welch and Satterthwaite. Elements without any variance must be equal.
    """
    mean_1, variance_1, freedom_1 = summary(first)
    mean_2, variance_2, freedom_2 = summary(second)
    _assert_no_difference(mean_1, mean_2, (variance_1, variance_2), (freedom_1, freedom_2), level)


def assert_mean(batches, expected, level=LEVEL):
    """Two-sided tests that independent batches have a known mean, element by element."""
    mean, variance, freedom = summary(batches)
    expected = np.broadcast_to(np.asarray(expected, dtype=np.float64), mean.shape)
    _assert_no_difference(mean, expected, (variance,), (freedom,), level)


def _assert_no_difference(mean_1, mean_2, variances, freedoms, level):
    difference = np.abs(mean_1 - mean_2)
    variance = sum(variances)
    spread = sum(v**2 / f for v, f in zip(variances, freedoms, strict=True))
    excess = np.maximum(difference - ROUNDING * np.maximum(np.abs(mean_1), np.abs(mean_2)), 0)
    random = variance > 0
    assert (excess[~random] == 0).all(), f"without noise, yet {difference[~random].max():.3g} apart"
    freedom = variance[random] ** 2 / spread[random]
    z = excess[random] / np.sqrt(variance[random])
    chance = 2 * stats.t.sf(z, freedom)
    worst = chance.min(initial=1)
    allowed = sidak(max(1, random.sum()), level)
    assert worst > allowed, f"{z.max():.2f} standard errors apart; a chance of {worst:.2g}, below {allowed:.2g}"


def assert_counts(counts, probabilities, level=LEVEL):
    """Chi-square test that counts follow the given probabilities."""
    counts, probabilities = np.ravel(counts), np.ravel(probabilities)
    expected = counts.sum() * probabilities
    assert np.isclose(probabilities.sum(), 1)
    assert expected.min() >= 20, "too few counts for the chi-square approximation"
    chance = stats.chisquare(counts, expected).pvalue
    assert chance > level, f"a chance of {chance:.2g}"
