"""Live scene in a browser: motion of the hand, its contacts and forces (extra ``view``).

Pure functions compute the drawing (``live_scene``, ``drawing``, ``panel_words``); only ``viewer`` passes the drawing to
viser, which sends it to the browsers.
"""
