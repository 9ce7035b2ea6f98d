"""A plan in words."""

from collections.abc import Mapping

from .needs import Reason


def explain(reasons: Mapping[str, Reason]) -> str:
    """One line per effect: whether it is on, its name, and why.

    Example:
        >>> print(explain({"ambient": Reason(on=True, why="the sky is not black")}))
        on   ambient  the sky is not black
    """
    width = max((len(name) for name in reasons), default=0)
    return "\n".join(f"{'on ' if r.on else 'off'}  {name:<{width}}  {r.why}" for name, r in reasons.items())
