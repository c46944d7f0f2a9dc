"""The live scene in a browser: what the hand does and feels (extra ``view``).

What is drawn is found by pure functions (``live_hand``, ``grasp_steps``, ``drawing``, ``panel_words``); ``viewer``
alone knows viser, and pushes it to whoever looks.
"""
