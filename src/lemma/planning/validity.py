"""Validity of symbolic sub-tasks: why no robot could do one, whatever it reaches."""

from collections.abc import Callable

from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import STICK, is_carried, is_region, kind_of
from lemma.tasks.subtask import Primitive, SubTask

WhyNot = Callable[[SubTask, SymbolicState], str | None]
"""Returns why no robot could do a sub-task now; None if it is valid."""


def why_not_move(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why no robot could ``move`` something somewhere; None if it is valid."""
    pick, place, regions = subtask.pick, subtask.place, now.spec.regions
    if pick == STICK:
        return None if place in regions else f"The stick cannot be put on {place}."
    if pick not in now.supports:
        return f"The {pick} is fixed to the table."
    if is_carried(pick):
        return f"One hand cannot hold the {pick}. Two robots carry it."
    if place == pick or (place not in regions and kind_of(place).support_m is None):
        return f"The {pick} cannot be put on {place}."
    for name in (pick, place):
        above = None if name in regions else now.on_top_of(name)
        if above is not None and above != pick:
            return f"The {above} lies on the {name}."
    if now.has(pick, place):
        return f"The {pick} lies there already."
    if place not in regions and _lacks_a_post(pick, place, now):
        return (
            f"The {pick} lies on two things, and nothing as high as the {place} stands "
            "as far from it as the plank spans."
        )
    return None


def _lacks_a_post(pick: str, place: str, now: SymbolicState) -> bool:
    return kind_of(pick).span_m is not None and now.across(pick, place) is None


def why_not_hand(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why no robot could ``reach`` or ``lift`` something; None if valid."""
    pick, primitive = subtask.pick, subtask.primitive
    if subtask.place != pick:
        return f"{primitive} has no place: it must be the {pick} again."
    if primitive is Primitive.LIFT and kind_of(pick).fixed:
        return f"The {pick} is fixed to the table."
    above = now.on_top_of(pick)
    return None if above is None else f"The {above} lies on the {pick}."


def unless_prepared(prepare: Primitive) -> WhyNot:
    """Return a function that says whether the stick was prepared by a primitive."""

    def why_not(subtask: SubTask, now: SymbolicState) -> str | None:
        if now.is_prepared(subtask.primitive, subtask.place):
            return None
        return (
            f"The stick does not lie ready for {subtask.place}: {prepare} comes first."
        )

    return why_not


def why_not_give(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why no robot could ``give`` something away; None if it is valid."""
    pick, place = subtask.pick, subtask.place
    if kind_of(pick).ends is None:
        return f"The {pick} has no two ends at which two hands hold it."
    if is_region(place) or kind_of(place).support_m is None or place == pick:
        return f"The {pick} cannot be put on {place}."
    for name in (pick, place):
        above = now.on_top_of(name)
        if above is not None and above != pick:
            return f"The {above} lies on the {name}."
    return f"The {pick} lies there already." if now.has(pick, place) else None


def why_not_carry(subtask: SubTask, now: SymbolicState) -> str | None:
    """Return why no robots could ``carry`` something somewhere; None if valid."""
    pick, place = subtask.pick, subtask.place
    carried = kind_of(pick).carried
    if carried is None:
        return f"The {pick} has no two handles by which it is carried."
    if is_region(place) or kind_of(place).support_m is None or place == pick:
        return f"The {pick} cannot be put on {place}."
    if kind_of(place).side_m < carried.rest_m:
        return f"The {place} is too small for the {pick}."
    above = now.on_top_of(place)
    if above is not None and above != pick:
        return f"The {above} lies on the {place}."
    return f"The {pick} lies there already." if now.has(pick, place) else None
