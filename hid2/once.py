"""Answers that are worked out once, and kept with the object that gives them."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, TypeVarTuple

Asked = TypeVarTuple("Asked")
Found = TypeVar("Found")


def once(method: Callable[[Any, *Asked], Found]) -> Callable[[Any, *Asked], Found]:
    """A method that works out its answer to the same arguments, told by position, once.

    The answers live as long as the object, which has no slots; `functools.cache` would keep it alive. A copy by
    `dataclasses.replace` has to work out its own.
    """
    name = f"_once_{method.__name__}"

    @wraps(method)
    def answer(self: Any, *asked: *Asked) -> Found:  # noqa: ANN401  # any object
        try:
            known: dict[tuple[*Asked], Found] = self.__dict__[name]
            return known[asked]
        except KeyError:  # of the first call, or of the first one with these arguments
            pass
        found = self.__dict__.setdefault(name, {})[asked] = method(self, *asked)
        return found

    return answer
