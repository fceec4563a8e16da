"""Goals: conjunctions of ``On(top, bottom)``."""

from dataclasses import dataclass
from typing import Self

from lemma.core.errors import InvalidConfigError
from lemma.scene.objects.entity import kind_of
from lemma.scene.scene import Scene
from lemma.tasks.support import carries_alone, is_at_rest, stands_on_a_face


@dataclass(frozen=True, slots=True)
class On:
    """One thing lies on another: a cube on a pad, or a cube on a cube."""

    top: str
    bottom: str

    def __post_init__(self) -> None:
        """Check that the kinds can be stacked.

        Raises:
            UnknownNameError: No such entity.
            InvalidConfigError: The top is fixed or a tool, nothing can lie on the
                bottom, or they are one thing.
        """
        if not kind_of(self.top).cargo or self.top == self.bottom:
            raise InvalidConfigError(
                f"On({self.top!r}, {self.bottom!r}): the top must be something that "
                "can be put somewhere, such as a cube, and not the bottom itself."
            )
        if kind_of(self.bottom).support_m is None:
            raise InvalidConfigError(
                f"On({self.top!r}, {self.bottom!r}): nothing can lie on the bottom; it "
                "must be a cube, a pad or another kind with support_m."
            )

    def holds(self, scene: Scene) -> bool:
        """Whether it is true now.

        The bottom alone carries the top: they touch, and nothing else touches the top
        but what lies on it. Both are at rest and level, on the table and not below it,
        and no robot touches either. The top's middle is no farther from the bottom's
        than the bottom's kind allows: on a pad at least 1 cm inside its edge, on a cube
        above its top face.
        """
        # From cheap to dear: this is asked at every step.
        return (
            self._is_above(scene)
            and all(is_at_rest(scene, name) for name in (self.top, self.bottom))
            and all(stands_on_a_face(scene, name) for name in (self.top, self.bottom))
            and not {self.top, self.bottom} & set(scene.fallen)
            and carries_alone(scene, self.bottom, self.top)
        )

    def _is_above(self, scene: Scene) -> bool:
        """Whether the top's middle is over the part of the bottom that may carry it."""
        limit = kind_of(self.bottom).support_m
        assert limit is not None
        top, bottom = scene.position(self.top), scene.position(self.bottom)
        dx, dy = top[0] - bottom[0], top[1] - bottom[1]
        return dx * dx + dy * dy <= limit * limit and top[2] > bottom[2]


@dataclass(frozen=True, slots=True)
class Goal:
    """Several ``On`` that shall hold at once."""

    conjuncts: tuple[On, ...]

    def __post_init__(self) -> None:
        """Check that it asks for something.

        Raises:
            InvalidConfigError: It has no conjuncts.
        """
        if not self.conjuncts:
            raise InvalidConfigError(
                "A goal without On(top, bottom) asks for nothing. Give at least one."
            )

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
        held = [on.holds(scene) for on in self.conjuncts]
        return held.count(True) / len(held)
