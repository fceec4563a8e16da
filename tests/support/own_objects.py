"""The example's own kind of object, color and task, registered for a while."""

import runpy
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from lemma.core.registry import Registry
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.scene.palette import OBJECT_COLORS
from lemma.tasks.suite import TASKS

EXAMPLE = Path(__file__).parents[2] / "examples" / "05_write_an_object.py"


@contextmanager
def forgotten() -> Iterator[None]:
    """Forget afterwards what is registered meanwhile."""
    registries: tuple[Registry[Any], ...] = (OBJECT_KINDS, OBJECT_COLORS, TASKS)
    with ExitStack() as stack:
        for registry in registries:
            for table in ("_records", "_added_by"):
                stack.enter_context(patch.dict(getattr(registry, table)))
        yield


@contextmanager
def own_objects() -> Iterator[None]:
    """Register what the example registers."""
    with forgotten():
        runpy.run_path(str(EXAMPLE), run_name="example")
        yield
