"""What a scene consists of: frozen data, no physics."""

from dataclasses import asdict, dataclass
from typing import Any

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.robots.ur.build import ARMS
from lemma.scene.palette import OBJECT_COLORS

ROBOT_COLORS = ("red", "white")
OBJECT_KINDS = ("cube", "pad", "stick")


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
    """``"cube"``, ``"pad"`` or ``"stick"``."""
    color: str
    """A name in ``lemma.scene.palette.OBJECT_COLORS``; ``"yellow"`` for the stick."""
    pose: Pose2
    """World from object, lying on the table. The stick's origin is the free end of its
    handle, its x axis points along the handle to the hook, which bends to +y."""

    def __post_init__(self) -> None:
        """Check the names."""
        if self.kind not in OBJECT_KINDS:
            raise UnknownNameError("object kind", self.kind, OBJECT_KINDS)
        if self.kind != "stick":
            OBJECT_COLORS[self.color]

    @property
    def name(self) -> str:
        """Entity name: ``"red_cube"``, ``"white_pad"``, ``"stick"``."""
        return STICK if self.kind == "stick" else f"{self.color}_{self.kind}"


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
        return tuple(f"robot_{i}" for i in range(len(self.robots)))

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

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "SceneSpec":
        """Make a scene from what :meth:`to_dict` returned."""
        return cls(
            tuple(
                RobotPlacement(r["arm"], r["color"], Pose2(**r["base"]))
                for r in data["robots"]
            ),
            tuple(
                ObjectPlacement(o["kind"], o["color"], Pose2(**o["pose"]))
                for o in data["objects"]
            ),
        )


STICK = "stick"
"""Name of the one L-shaped stick."""
SHARED = "shared"
"""Place entity: the region that every robot of the team reaches."""
ENTITIES = (
    *(f"{color}_cube" for color in OBJECT_COLORS),
    *(f"{color}_pad" for color in OBJECT_COLORS),
    STICK,
)
"""Every object that may be on a table, in the order of their numbers."""
