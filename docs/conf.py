import sys
from pathlib import Path

from lemma import __version__

sys.path.insert(0, str(Path(__file__).parent))

project = "LEMMA Bench"
author = "The LEMMA Bench maintainers"
release = __version__

extensions = ["myst_parser", "facts"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
nitpicky = True

html_theme = "furo"
html_title = f"{project} {release}"
