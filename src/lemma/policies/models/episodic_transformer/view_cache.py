"""Features of views that were seen before, as long as somebody holds the views."""

from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from lemma.env.view import View


class ViewCache:
    """A network's features of views; forgets a view that nobody else refers to.

    A closed loop looks at each view again at every later decision. A copy starts empty.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._found: WeakKeyDictionary[View, Tensor] = WeakKeyDictionary()
        self._state: object = None

    def __len__(self) -> int:
        """Return how many views are known."""
        return len(self._found)

    def clear(self) -> None:
        """Forget all."""
        self._found.clear()

    def features(
        self,
        views: Sequence[View],
        compute: Callable[[list[View]], Tensor],
        state: object = None,
    ) -> Tensor:
        """Return the features of views, (len(views), ...), computing what is new.

        Args:
            views: At least one.
            compute: Maps views to features, one row each.
            state: Of the network; when another is given, all is forgotten.
        """
        if state != self._state:
            self.clear()
            self._state = state
        new = [view for view in dict.fromkeys(views) if view not in self._found]
        if new:
            self._found.update(zip(new, compute(new), strict=True))
        return torch.stack([self._found[view] for view in views])

    def __deepcopy__(self, memo: dict[int, Any]) -> "ViewCache":
        """Return an empty one."""
        return ViewCache()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as an empty one."""
        return ViewCache, ()
