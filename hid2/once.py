"""Answers that are worked out once, and kept with the object that gives them."""

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

Asked = ParamSpec("Asked")
Found = TypeVar("Found")


def once(method: Callable[Concatenate[Any, Asked], Found]) -> Callable[Concatenate[Any, Asked], Found]:
    """A method that works out its answer to the same arguments once.

    The answers live as long as the object, which has no slots; `functools.cache` would keep it alive. A copy by
    `dataclasses.replace` has to work out its own.
    """
    name = f"_once_{method.__name__}"

    @wraps(method)
    def answer(self: Any, *args: Asked.args, **kwargs: Asked.kwargs) -> Found:  # noqa: ANN401  # any object
        known: dict[Any, Found] = self.__dict__.setdefault(name, {})
        key = (args, *kwargs.items()) if kwargs else args
        if key not in known:
            known[key] = method(self, *args, **kwargs)
        return known[key]

    return cast("Callable[Concatenate[Any, Asked], Found]", answer)
