"""The families of the suite ``teams``: one file each, registered when imported."""

from importlib import import_module

from lemma.tasks import library  # noqa: F401 - tasks of the paper come first
from lemma.tasks.names import FAMILIES

for _name in FAMILIES:
    import_module(f"lemma.tasks.families.{_name}")
