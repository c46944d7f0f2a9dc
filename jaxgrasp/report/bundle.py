"""Puts figures and the plotting library into the page, so that it opens offline."""

import base64
import gzip
import json
from functools import cache
from importlib.resources import files

MISSING = "the report needs plotly: pip install 'jaxgrasp[report]'"


@cache
def plotly_bundle() -> str:
    """plotly.js, compressed and in base64; the page unpacks it.

    The Python package ships the full library alone, 4.8 MB. Compressed it adds 2 MB to the page, and every
    browser since 2023 has the decompressor.
    """
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise ImportError(MISSING) from None
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9, mtime=0)).decode()


def asset(name: str) -> str:
    """A file that stands beside this module: the style and the script of the page."""
    return files("jaxgrasp.report").joinpath(name).read_text(encoding="utf-8")


def embedded(name: str, data: object) -> str:
    """Data for the page's script, in a form that no text inside it can break out of."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{text}</script>'
