"""The documentation site: ``sphinx-build -W --keep-going -b html docs docs/_build/html``."""

import sys
from importlib.metadata import version as installed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import generate

project = "crowdbench"
version = release = installed("crowdbench-nav")
copyright = "the crowdbench maintainers"
html_title = f"{project} {version}"
html_theme = "furo"
html_theme_options = {"navigation_with_keys": True}
html_show_sphinx = False

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "_generated"]
myst_enable_extensions = ["attrs_inline"]
myst_heading_anchors = 3
autoclass_content = "both"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
maximum_signature_line_length = 70
napoleon_numpy_docstring = False
napoleon_use_ivar = True


def setup(app):
    """Write what the code knows best before any page is read."""
    app.connect("builder-inited", lambda app: generate.write(Path(app.srcdir) / "_generated"))
