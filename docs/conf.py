"""Settings of the site, which ``sphinx-build -W -c docs . build/site`` builds.

The source folder is the repository itself, so that links between README, docs, notebooks and pages of benchmarks have
the same targets on the site and in the tree. The build imports the package and executes nothing else: notebooks are
committed with their outputs, and the tests execute them.
"""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "docs" / "extensions"), str(ROOT)]

project = "jaxgrasp"
author = "the authors of jaxgrasp"
copyright = f"2026, {author}, Apache License 2.0"  # at the foot of every page
version = release = version_of("jaxgrasp")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "command_line",
    "mathml",
    "outcomes",
    "prose_docstrings",
    "rooms",
]
root_doc = "docs/index"
include_patterns = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "benchmarks/results/*.md",
    "docs/**",
    "jaxgrasp/glove/protocol/firmware/PROTOCOL.md",
    "notebooks/*.ipynb",
]
exclude_patterns = ["**/.ipynb_checkpoints", ".[!/]*/**", "build/**", "tests/**"]

# Markdown and notebooks. A link to a heading or a file that is not there is a warning, and warnings are errors.
nb_execution_mode = "off"
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
html_math_renderer = "mathml"
suppress_warnings = ["myst.header"]  # benchmark pages begin below the first level

# Docstrings. Types of other packages have no page here.
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(?!jaxgrasp\.).*"),
    ("py:class", r"jaxgrasp\.\w+\.\w+\..*"),  # annotations name types that no room shows
]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
maximum_signature_line_length = 100
add_module_names = False

html_theme = "furo"
html_title = f"{project} {version}"  # on every page, in the sidebar and in the browser's tab
html_static_path = ["static"]
html_extra_path = ["front"]  # index.html at the site's root leads to docs/index.html
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_last_updated_fmt = None


def setup(app) -> None:
    """Register a plain lexer for Mermaid: the site shows the source of ARCHITECTURE's diagram."""
    from pygments.lexers.special import TextLexer

    app.add_lexer("mermaid", TextLexer)
