"""Assembly of a page from figures, data and the plotting library, so that it opens offline."""

import base64
import gzip
import json
from functools import cache
from importlib.resources import files

import numpy as np

from jaxgrasp.report.look import text
from jaxgrasp.validation.optional_library import optional_library

MISSING = "the report needs plotly: pip install 'jaxgrasp[report]'"

# The page may run what it carries and may fetch nothing: the browser itself holds it to opening offline.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; worker-src blob:; base-uri 'none'; form-action 'none'"
)


@cache
def plotly_bundle() -> str:
    """Return plotly.js compressed and in base64; the page unpacks it.

    The Python package ships the full library alone, 4.8 MB. Compressed it adds 2 MB to the page, and every
    browser since 2023 has the decompressor.
    """
    library = optional_library("plotly.offline", missing=MISSING)
    return base64.b64encode(gzip.compress(library.get_plotlyjs().encode(), 6, mtime=0)).decode()


def asset(name: str) -> str:
    """Return the text of a file beside this module, such as the style or a script of the page."""
    return files("jaxgrasp.report").joinpath(name).read_text(encoding="utf-8")


def embedded(name: str, data: object) -> str:
    """Return a script element with data as JSON; no text inside the data can close the element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{text}</script>'


def listed(array: np.ndarray, decimals: int) -> list:
    """Convert an array to lists of rounded numbers; NaN and infinity become None, which plotly draws as a gap."""
    rounded = np.round(np.asarray(array, float), decimals)
    values = rounded.astype(object)
    values[~np.isfinite(rounded)] = None
    return values.tolist()


def page_html(title: str, body: str, *scripts: str) -> str:
    """Return the complete HTML page around a body, with plotly and the scripts of these file names."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="jaxgrasp">
<title>{text(title)}</title>
<style>
{asset("style.css")}</style>
</head>
<body>
<main>
<noscript><p class="note">The figures need JavaScript; the numbers and tables do not.</p></noscript>
{body}
<footer>Written by jaxgrasp. Figures by plotly.js, MIT licence, © Plotly, Inc.; it is inside this file, which
fetches nothing. SI units, but for angles that are marked \N{DEGREE SIGN}.</footer>
</main>
<script type="text/plain" id="library">{plotly_bundle()}</script>
<script>
{asset("library.js")}{"".join(map(asset, scripts))}</script>
</body>
</html>
"""
