"""What shall become true: a conjunction of ``On(top, bottom)``."""

from dataclasses import dataclass
from typing import Self

from lemma.core.errors import InvalidConfigError
from lemma.scene.objects import CUBE_EDGE_M, PAD_RADIUS_M, PAD_THICKNESS_M
from lemma.scene.scene import Scene

_REST_M_S = 0.02
_HEIGHT_TOLERANCE_M = 0.006
_ON_PAD_M = PAD_RADIUS_M - 0.01
_ON_CUBE_M = CUBE_EDGE_M / 2


@dataclass(frozen=True, slots=True)
class On:
    """One thing lies on another: a cube on a pad, or a cube on a cube."""

    top: str
    bottom: str

    def __post_init__(self) -> None:
        """Check that the kinds can be stacked."""
        if not self.top.endswith("_cube") or self.top == self.bottom:
            raise InvalidConfigError(
                f"On({self.top!r}, {self.bottom!r}): the top must be a cube that is "
                "not the bottom itself."
            )
        if not self.bottom.endswith(("_cube", "_pad")):
            raise InvalidConfigError(
                f"On({self.top!r}, {self.bottom!r}): the bottom must be a cube or a "
                "pad."
            )

    def holds(self, scene: Scene) -> bool:
        """Whether it is true now, with the top at rest.

        A cube is on a pad when its centre is at least 1 cm inside the pad's edge, and
        on a cube when its centre is above the lower cube's top face; its height must
        say that nothing else carries it.
        """
        top, bottom = scene.pose(self.top).position, scene.pose(self.bottom).position
        on_pad = self.bottom.endswith("_pad")
        limit = _ON_PAD_M if on_pad else _ON_CUBE_M
        rise = PAD_THICKNESS_M + CUBE_EDGE_M / 2 if on_pad else CUBE_EDGE_M
        dx, dy = top[0] - bottom[0], top[1] - bottom[1]
        return (
            dx * dx + dy * dy <= limit * limit
            and abs(top[2] - bottom[2] - rise) <= _HEIGHT_TOLERANCE_M
            and scene.speed(self.top) < _REST_M_S
        )


@dataclass(frozen=True, slots=True)
class Goal:
    """Several ``On`` that shall hold at once."""

    conjuncts: tuple[On, ...]

    @classmethod
    def from_pairs(cls, pairs: tuple[tuple[str, str], ...]) -> Self:
        """Make a goal from (top, bottom) pairs."""
        return cls(tuple(On(top, bottom) for top, bottom in pairs))

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The (top, bottom) pairs."""
        return tuple((on.top, on.bottom) for on in self.conjuncts)

    @property
    def entities(self) -> tuple[str, ...]:
        """Every object that the goal speaks of, each once."""
        return tuple(dict.fromkeys(name for pair in self.pairs for name in pair))

    def progress(self, scene: Scene) -> float:
        """Return the fraction of conjuncts that hold, in [0, 1]."""
        return sum(on.holds(scene) for on in self.conjuncts) / len(self.conjuncts)
