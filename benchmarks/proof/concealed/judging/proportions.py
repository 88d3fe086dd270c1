"""Counts as shares, with one-sided 95 % bounds of Clopper and Pearson (1934)."""

from scipy.stats import beta


def share(count: int, of: int) -> dict[str, float | int | None]:
    """`count` out of `of`, and the one-sided bounds of the true share at 95 % confidence."""
    if of == 0:
        return {"count": 0, "of": 0, "share": None, "at_least": None, "at_most": None}
    return {
        "count": int(count),
        "of": int(of),
        "share": count / of,
        "at_least": float(beta.ppf(0.05, count, of - count + 1)) if count else 0.0,
        "at_most": float(beta.ppf(0.95, count + 1, of - count)) if count < of else 1.0,
    }
