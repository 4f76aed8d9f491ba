"""What is computed once and kept with the search that it belongs to."""

from __future__ import annotations

from collections.abc import Callable, Sized
from functools import wraps
from typing import Any, TypeVar

S = TypeVar("S", bound=Sized)
T = TypeVar("T")


class Recent:
    """A few results, each kept for the very objects it was computed from; the oldest goes first."""

    def __init__(self, most: int):
        self.most = most
        self._known: dict[Any, tuple[tuple[Any, ...], Any]] = {}

    def get(self, *owners: Any) -> Any:
        """Give what was kept for these objects, or None."""
        found = self._known.get(self._name(owners))
        return found[1] if found is not None else None

    def keep(self, value: Any, *owners: Any) -> Any:
        """Keep a result and give it back."""
        self._known[self._name(owners)] = (owners, value)
        while len(self._known) > self.most:
            self._known.pop(next(iter(self._known)))
        return value

    def values(self) -> list[Any]:
        """Give all that is kept."""
        return [value for _, value in self._known.values()]

    def shrink(self, small: Callable[[list[Any]], bool]) -> None:
        """Forget the oldest until what is kept is small enough, or nothing is."""
        while self._known and not small(self.values()):
            self._known.pop(next(iter(self._known)))

    @staticmethod
    def _name(owners: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(x if isinstance(x, tuple | frozenset | bool) else id(x) for x in owners)


def kept(function: Callable[..., S]) -> Callable[..., S]:
    """Keep the last few results of a function of a search, and of what belongs to it, with the search."""

    @wraps(function)
    def known(search: Any, *owners: Any) -> S:
        recent = search.recent(function.__name__)
        found = recent.get(*owners)
        if found is None:
            found = function(search, *owners)
            if len(found):  # nothing at all is soon made again
                recent.keep(found, *owners)
        return found

    return known


def lasting(function: Callable[[Any], T]) -> Callable[[Any], T]:
    """Compute once what a function makes of a search, for those about other models of the same recordings as well."""

    @wraps(function)
    def known(search: Any) -> T:
        if function.__name__ not in search.lasting:
            search.lasting[function.__name__] = function(search)
        return search.lasting[function.__name__]

    return known
