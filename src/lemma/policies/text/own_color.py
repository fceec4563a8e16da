"""Things that a sentence names by the color of another: "the pad of its own color"."""

import re

from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.palette import BENCHMARK_COLORS

_COLORS_NAMED = re.compile(r"\b(?:" + "|".join(BENCHMARK_COLORS) + r")\b")
_NOUN = "|".join(sorted({*CUBE.nouns, *PAD.nouns, "mat", "disc", "brick", "spot"}))
_SAME = r"(?:its|the|that|their) (?:very )?(?:own|same|very)(?: own)? colou?r"
_OWN = re.compile(
    rf"\bthe (?P<noun>{_NOUN})"
    rf" (?:(?:of|in|with|having) (?:{_SAME}|its colou?r)"
    r"|(?:that|which) (?:has|shares|matches) (?:its|the same)(?: own)? colou?r)"
    rf"|\b(?:the|its) (?:matching|same[- ]colou?red|like-colou?red) (?P<noun2>{_NOUN})",
    re.IGNORECASE,
)


def resolved(text: str) -> str:
    """Return a text in which "the pad of its own color" has the color's name.

    Only where one color is named in all, so that there is no doubt.
    """
    colors = set(_COLORS_NAMED.findall(text.lower()))
    if len(colors) != 1:
        return text
    color = colors.pop()
    return _OWN.sub(lambda m: f"the {color} {m['noun'] or m['noun2']}", text)
