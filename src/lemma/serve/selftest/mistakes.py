"""Which of the usual mistakes explains a wrong answer of the self-test."""

import math
from collections.abc import Callable, Mapping, Sequence

TOLERANCE = 1e-3
"""Metres or radians that do not matter."""
COLOR_TOLERANCE = 12
"""Levels of a color that do not matter: a picture may have been compressed."""

Point = tuple[float, float]
Color = tuple[int, int, int]
Numbers = Sequence[Sequence[float]]

_LENGTHS = {100.0: "centimetres", 1000.0: "millimetres"}
_MIRRORS: dict[str, Callable[[float, float], Point]] = {
    "upside down: row 0 lies at +y": lambda x, y: (x, -y),
    "mirrored: column 0 lies at -x": lambda x, y: (-x, y),
    "turned by half a turn: row 0 lies at +y, and column 0 at -x": lambda x, y: (
        -x,
        -y,
    ),
}


def diagnose_poses(answers: Numbers, truth: Numbers, says: str) -> dict[str, str]:
    """Return what is wrong with poses (x [m], y [m], yaw [rad]).

    Args:
        answers: What was answered.
        truth: What is right; half a turn makes no difference to a gripper.
        says: How a complaint begins.
    """
    found: dict[str, str] = {}
    told = f"{says} {_show(truth[0])} as {_show(answers[0])}"
    positions = [(float(a[0]), float(a[1])) for a in answers]
    right = [(t[0], t[1]) for t in truth]
    found.update(_of_positions(positions, right, told))
    yaws = [float(answer[2]) for answer in answers]
    expected = [float(pose[2]) for pose in truth]
    if _same_yaws(yaws, expected):
        return found
    if _same_yaws(yaws, [-yaw for yaw in expected]):
        found["yaw sign"] = (
            f"{told}: mirrored. Yaw is counter-clockwise seen from above, x to the "
            "right and y up."
        )
    elif _close(yaws, [math.degrees(yaw) for yaw in expected], 0.1):
        found["units of angle"] = f"{told}: degrees. Angles are in radians."
    elif _same_yaws(yaws, [yaw + math.pi / 2 for yaw in expected]):
        found["axes"] = (
            f"{told}: a quarter turn off. Yaw is the direction of the gripper's x "
            "axis; it closes along its y axis."
        )
    else:
        found["quaternion order"] = (
            f"{told}. Quaternions are w, x, y, z, of a gripper that points down, and "
            "yaw is the direction of its x axis."
        )
    return found


def diagnose_positions(answers: Numbers, truth: Sequence[Point]) -> dict[str, str]:
    """Return what is wrong with the positions of cells of the map [m]."""
    given = [(float(a[0]), float(a[1])) for a in answers]
    told = f"It places a cell of the map that lies at {_show(truth[0])} at "
    told += _show(given[0])
    if _close_points(given, truth):
        return {}
    if _close_points(given, truth, 0.0081):
        return {"image orientation": f"{told}. The middle of the cell is meant."}
    for how, mirror in _MIRRORS.items():
        # A mirror that maps cells to cells may be off by one of them.
        if _close_points(given, [mirror(x, y) for x, y in truth], 0.009):
            return {"image orientation": f"{told}: {how}."}
    return _of_positions(given, truth, told)


def diagnose_colors(answers: Numbers, truth: Mapping[Point, Color]) -> dict[str, str]:
    """Return what is wrong with the colors that are seen at points [m]."""
    seen = [tuple(round(float(v)) for v in color) for color in answers]
    told = f"At {_show(next(iter(truth)))} it sees {seen[0]}, where the picture has "
    told += str(next(iter(truth.values())))
    if _same_colors(seen, list(truth.values())):
        return {}
    mirrors = {"": lambda x, y: (x, y), **_MIRRORS}
    for how, mirror in mirrors.items():
        there = [truth[mirror(x, y)] for x, y in truth]
        found = {"image orientation": f"{told}: {how}."} if how else {}
        if _same_colors(seen, there):
            return found
        if _same_colors(seen, [(b, g, r) for r, g, b in there]):
            return {**found, "color order": f"{told}: BGR. Colors are RGB."}
    return {
        "image orientation": f"{told}. Row 0 of the map lies at +y, column 0 at -x; "
        "colors are RGB from 0 to 255."
    }


def diagnose_lengths(
    answers: Sequence[float], truth: Mapping[Point, float]
) -> dict[str, str]:
    """Return what is wrong with the heights that are seen at points [m]."""
    given, right = [float(v) for v in answers], list(truth.values())
    if _close(given, right):
        return {}
    told = f"It sees a height of {given[0]:g} m where it is {right[0]:g} m"
    for how, mirror in _MIRRORS.items():
        if _close(given, [truth[mirror(x, y)] for x, y in truth]):
            return {"image orientation": f"{told}: {how}."}
    return {"units of length": f"{told}. Heights are in metres."}


def diagnose_robots(
    joints: Mapping[str, Sequence[float]],
    true_joints: Mapping[str, Sequence[float]],
    openings_m: Mapping[str, float],
    true_openings_m: Mapping[str, float],
) -> dict[str, str]:
    """Return what is wrong with joints [rad] and openings [m] by name of the robot."""
    first, second = true_joints
    told = f"Asked for the joints of the {first}, it says {_show(joints[first])}, not "
    told += _show(true_joints[first])
    order = "The first robot of the list stands at -x and has row 0."
    found: dict[str, str] = {}
    if _close(joints[first], true_joints[second]):
        found["robot order"] = f"{told}: the other robot's. {order}"
    elif _close(joints[first], [math.degrees(v) for v in true_joints[first]], 0.1):
        found["units of angle"] = f"{told}: degrees. Angles are in radians."
    elif not all(_close(joints[name], true_joints[name]) for name in true_joints):
        found["decision"] = f"{told}. Joints go from the base to the wrist, in radians."
    opening, right = float(openings_m[first]), true_openings_m[first]
    told = f"The {first} opens its gripper by {opening:g} m, it says, not {right:g} m"
    if _close([opening], [true_openings_m[second]]):
        found.setdefault("robot order", f"{told}: the other robot's. {order}")
    elif not _close([opening], [right]):
        found["units of length"] = f"{told}. Openings are in metres."
    return found


def _of_positions(
    given: Sequence[Point], truth: Sequence[Point], told: str
) -> dict[str, str]:
    if _close_points(given, truth):
        return {}
    for factor, unit in _LENGTHS.items():
        if _close_points(given, [(factor * x, factor * y) for x, y in truth], 0.5):
            return {"units of length": f"{told}: {unit}. Lengths are in metres."}
    changes: dict[str, Callable[[float, float], Point]] = {
        "x and y are swapped": lambda x, y: (y, x),
        "y is mirrored": lambda x, y: (x, -y),
        "x is mirrored": lambda x, y: (-x, y),
        "both axes are reversed": lambda x, y: (-x, -y),
    }
    for how, change in changes.items():
        if _close_points(given, [change(x, y) for x, y in truth]):
            return {
                "axes": f"{told}: {how}. x leads from the first robot to the second."
            }
    return {"axes": f"{told}. The origin is the middle of the table."}


def _close(
    answers: Sequence[float], truth: Sequence[float], within: float = TOLERANCE
) -> bool:
    return len(answers) == len(truth) and all(
        abs(float(a) - t) <= within for a, t in zip(answers, truth, strict=True)
    )


def _close_points(
    answers: Sequence[Point], truth: Sequence[Point], within: float = TOLERANCE
) -> bool:
    return len(answers) == len(truth) and all(
        _close(a, t, within) for a, t in zip(answers, truth, strict=True)
    )


def _same_yaws(answers: Sequence[float], truth: Sequence[float]) -> bool:
    return len(answers) == len(truth) and all(
        abs(math.remainder(a - t, math.pi)) <= TOLERANCE
        for a, t in zip(answers, truth, strict=True)
    )


def _same_colors(
    seen: Sequence[tuple[int, ...]], truth: Sequence[tuple[int, ...]]
) -> bool:
    return len(seen) == len(truth) and all(
        len(a) == len(t)
        and all(abs(p - q) <= COLOR_TOLERANCE for p, q in zip(a, t, strict=True))
        for a, t in zip(seen, truth, strict=True)
    )


def _show(numbers: Sequence[float]) -> str:
    return f"({', '.join(f'{float(v):.4g}' for v in numbers)})"
