"""A cache of a network's results for views."""

from typing import Any, Self, TypeVar
from weakref import WeakKeyDictionary

from torch import nn

from lemma.env.view import View

Result = TypeVar("Result")


class ViewCache(WeakKeyDictionary[View, Result]):
    """A cache of a network's results for views, with weak references to the views.

    In a closed loop each view is an input of every later decision. Copies start empty.
    """

    _state: object = None
    """State of the network for which the results are valid."""

    def valid(self, network: nn.Module) -> Self:
        """Return this cache, without results from before a change of the weights.

        Args:
            network: The network whose results are kept.
        """
        weights = list(network.parameters())
        state = weights[0].device, weights[0].dtype, sum(w._version for w in weights)
        if state != self._state:
            self.clear()
            self._state = state
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return an empty cache."""
        return type(self)()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as an empty cache."""
        return type(self), ()
