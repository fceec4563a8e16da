"""What a scene consists of: frozen data, no physics."""

from dataclasses import dataclass

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_names
from lemma.robots.ur.arms import ARMS
from lemma.scene.objects.entity import Entity
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.scene.palette import OBJECT_COLORS

ROBOT_COLORS = ("red", "white")


@dataclass(frozen=True, slots=True)
class RobotPlacement:
    """One robot: what it is and where it stands."""

    arm: str
    """Arm type, a name in ``lemma.robots.ur.build.ARMS``."""
    color: str
    """``"red"`` or ``"white"``."""
    base: Pose2
    """World from base: the yaw points the robot's front at the table."""

    def __post_init__(self) -> None:
        """Check the names."""
        ARMS[self.arm]
        if self.color not in ROBOT_COLORS:
            raise UnknownNameError("robot color", self.color, ROBOT_COLORS)


@dataclass(frozen=True, slots=True)
class ObjectPlacement:
    """One object: what it is and where it lies."""

    kind: str
    """A name in ``lemma.scene.objects.kind.OBJECT_KINDS``: ``"cube"``."""
    color: str
    """A name in ``lemma.scene.palette.OBJECT_COLORS``. What comes in one color only may
    say any word: the stick is ``"yellow"``."""
    pose: Pose2
    """World from object, lying on the table."""

    def __post_init__(self) -> None:
        """Check the names."""
        if OBJECT_KINDS[self.kind].colored:
            OBJECT_COLORS[self.color]

    @property
    def entity(self) -> Entity:
        """What it is."""
        kind = OBJECT_KINDS[self.kind]
        return Entity(self.color if kind.colored else "", kind)

    @property
    def name(self) -> str:
        """Entity name: ``"red_cube"``, ``"white_pad"``, ``"stick"``."""
        return self.entity.name


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """Everything that a compiled scene depends on."""

    robots: tuple[RobotPlacement, ...]
    objects: tuple[ObjectPlacement, ...]

    def __post_init__(self) -> None:
        """Check that every entity can be named without doubt."""
        names = [placed.name for placed in self.objects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidConfigError(
                f"Objects named twice in one scene: {', '.join(twice)}. Each kind and "
                "color may occur once; choose another color."
            )

    @property
    def robot_names(self) -> tuple[str, ...]:
        """``("robot_0", "robot_1", ...)``."""
        return robot_names(len(self.robots))

    @property
    def object_names(self) -> tuple[str, ...]:
        """Entity names in the order of ``objects``."""
        return tuple(placed.name for placed in self.objects)

    def placement(self, name: str) -> ObjectPlacement:
        """Return the object called ``name``.

        Raises:
            UnknownNameError: There is no such object in this scene.
        """
        for placed in self.objects:
            if placed.name == name:
                return placed
        raise UnknownNameError("object in this scene", name, self.object_names)
