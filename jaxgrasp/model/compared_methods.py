"""The four answers that an evaluation compares: each closed form, and its own optimum.

Comparing A with B would compare two objectives; a closed form is a relaxation of its own optimum, and the
difference between the two is the price of friction.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ComparedMethod:
    """A method of distributing forces."""

    name: str
    title: str
    sharing: str
    constrained: bool


METHODS = {
    method.name: method
    for method in (
        ComparedMethod("A", "method A (eq. 11), uniform sharing", "uniform", constrained=False),
        ComparedMethod("B", "method B (eq. 15), sharing by squeeze", "squeeze", constrained=False),
        ComparedMethod("A-optimum", "constrained optimum, uniform sharing", "uniform", constrained=True),
        ComparedMethod("B-optimum", "constrained optimum, sharing by squeeze", "squeeze", constrained=True),
    )
}


def methods_named(names: tuple[str, ...]) -> tuple[ComparedMethod, ...]:
    """Return the methods of these names, each once, in the order of the table above."""
    for name in names:
        if name not in METHODS:
            raise ValueError(f"method {name!r} is unknown: expected one or more of {', '.join(METHODS)}")
    if not names:
        raise ValueError(f"methods is empty: expected one or more of {', '.join(METHODS)}")
    return tuple(method for name, method in METHODS.items() if name in names)
