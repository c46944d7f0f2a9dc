"""Type checks of functions, made when first called, and without what array shapes need where there are none.

jaxtyping's import hook, which pytest installs, binds the arguments of every call and remembers the sizes of axes. That
takes twenty times as long as the checks themselves, of which there are millions: more than half of the time of the
glove's tests.
"""

import inspect
from collections.abc import Callable, Iterator
from functools import cache, wraps
from typing import Any, get_args

import jaxtyping

with_shapes = jaxtyping.jaxtyped


def check_lightly() -> None:
    """Check the shapes of all functions that are imported from now on and have any in their annotations."""
    jaxtyping.jaxtyped = _checked


def _checked(*, typechecker: Callable) -> Callable:
    """Stand in for ``jaxtyping.jaxtyped``, under whose name the import hook calls it."""

    def decorate(decorated: Any) -> Any:
        how = _with_checks if inspect.isfunction(decorated) else with_shapes
        return how(decorated, typechecker=typechecker)

    return decorate


def _with_checks(function: Callable, *, typechecker: Callable) -> Callable:
    @cache
    def checked() -> Callable:
        return with_shapes(function, typechecker=typechecker) if _may_say_shapes(function) else typechecker(function)

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        return (function if jaxtyping.config.jaxtyping_disable else checked())(*args, **kwargs)

    return call


def _may_say_shapes(function: Callable) -> bool:
    """Return True where an annotation has shapes, or is a string, which only jaxtyping resolves correctly."""
    return any(
        isinstance(part, str) or (inspect.isclass(part) and issubclass(part, jaxtyping.AbstractArray))
        for annotation in function.__annotations__.values()
        for part in _parts(annotation)
    )


def _parts(annotation: Any) -> Iterator[Any]:
    yield annotation
    for part in (*get_args(annotation), *(annotation if isinstance(annotation, list) else ())):
        yield from _parts(part)
