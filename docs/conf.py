"""The documentation site: `make docs` builds it into out/docs, offline, any warning an error."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "quaffure"
author = "the quaffure authors"
release = version_of("quaffure")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "site_extension"]
exclude_patterns = ["Makefile"]
default_role = "code"
html_theme = "furo"
html_title = f"quaffure {release}"
html_show_sphinx = False

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "dollarmath"]
html_math_renderer = "mathml"

napoleon_use_ivar = True
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
# Entries of every member in the side bar take minutes.
toc_object_entries = False
