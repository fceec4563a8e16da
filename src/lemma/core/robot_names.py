"""Names of the robots of a scene: ``"robot_0"``, ``"robot_1"`` and so on."""

from lemma.core.errors import UnknownNameError

_PREFIX = "robot_"


def robot_name(number: int) -> str:
    """Return the name of the robot with a number in the scene, from 0."""
    return f"{_PREFIX}{number}"


def robot_names(count: int) -> tuple[str, ...]:
    """Return the names of ``count`` robots: ``("robot_0", "robot_1", ...)``."""
    return tuple(map(robot_name, range(count)))


def robot_number(name: str) -> int:
    """Return the number of a robot, the inverse of :func:`robot_name`.

    Raises:
        UnknownNameError: The name is not that of a robot.
    """
    digits = name.removeprefix(_PREFIX)
    if not digits.isdecimal() or name != robot_name(int(digits)):
        raise UnknownNameError("robot", name, (*robot_names(2), "and so on"))
    return int(digits)
