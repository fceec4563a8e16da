"""Which instance a verb works on: frozen by split and index, or sampled by seed."""

from lemma.core.errors import InvalidConfigError
from lemma.robots.ur import ARMS
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, load_instance, task_named

DEFAULT_SPLIT = "test"


def select_instance(
    task: str,
    *,
    split: str | None = None,
    index: int | None = None,
    seed: int | None = None,
    robots: str | None = None,
) -> Instance:
    """Return the instance that a user asked for.

    Args:
        task: Name of the task.
        split: Split of the frozen list, ``"test"`` if None.
        index: Number in the split, 0 if None.
        seed: Sample a new instance with this seed instead.
        robots: Arm types from left to right, ``"ur5,ur10"``; samples as well.

    Raises:
        UnknownNameError: No such task, split or arm type.
        InvalidConfigError: The index is out of range, or the wishes contradict.
    """
    task_named(task)
    if seed is None and robots is None:
        return load_instance(task, split or DEFAULT_SPLIT, index or 0)
    if split not in (None, FREE_SPLIT) or (seed is not None and index is not None):
        raise InvalidConfigError(
            "Frozen instances (--split, --index) have their robots and need no seed. "
            "Leave those out, or leave out --seed and --robots, which sample anew."
        )
    number = (index or 0) if seed is None else seed
    if number < 0:
        raise InvalidConfigError(f"A seed is 0 or more, not {number}.")
    if robots is None:
        return load_instance(task, FREE_SPLIT, number)
    team = _team(robots)
    return sample(task_named(task), FREE_SPLIT, number, team=team).instance


def _team(robots: str) -> tuple[str, str]:
    names = [name.strip() for name in robots.split(",")]
    for name in names:
        ARMS[name]
    if len(names) != 2:
        raise InvalidConfigError(
            f"--robots {robots} names {len(names)} arm type(s), but a team has two. "
            f"Separate them by a comma: ur5,ur10. Valid: {', '.join(ARMS)}."
        )
    return names[0], names[1]
