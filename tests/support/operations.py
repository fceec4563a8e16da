"""Tensor operations that pass by while tests watch."""

from collections.abc import Mapping, Sequence
from typing import Any

from torch.utils._python_dispatch import TorchDispatchMode


class Operations(TorchDispatchMode):
    """Shows every operation to :meth:`look` before it runs."""

    def look(self, name: str, args: tuple[Any, ...]) -> None:
        """Look at an operation and its arguments."""
        raise NotImplementedError

    def __torch_dispatch__(
        self,
        func: Any,
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        self.look(func.overloadpacket.__name__, args)
        return func(*args, **(kwargs or {}))
