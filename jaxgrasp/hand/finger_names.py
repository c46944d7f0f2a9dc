"""Finger and phalanx of each link: given by the user, or read from the link's name where that is clear."""

import re
from collections.abc import Mapping

from jaxgrasp.model.hand import Hand, Link
from jaxgrasp.validation.checked import checked

FINGERS = {
    "thumb": ("thumb", "th"),
    "index": ("index", "ff"),
    "middle": ("middle", "mf"),
    "ring": ("ring", "rf"),
    "little": ("little", "pinky", "pinkie", "lf"),
}
"""Names of the fingers in files; the letters are Shadow's: first, middle, ring and little finger, and thumb."""
PHALANGES = {
    "palm": ("metacarpal", "palm"),
    "proximal": ("proximal",),
    "middle": ("middle", "medial", "intermediate"),
    "distal": ("distal",),
}
PALM = ("middle", "palm")
"""Finger and phalanx of a palm that is one body."""


def _alternatives(words: Mapping[str, tuple[str, ...]], group: str) -> str:
    return f"(?P<{group}>{'|'.join(word for synonyms in words.values() for word in synonyms)})"


_LINK = re.compile(rf"{_alternatives(FINGERS, 'finger')}[ _.-]?{_alternatives(PHALANGES, 'phalanx')}(?:[ _.-]?link)?")
_PALM = re.compile(r"palm(?:[ _.-]?link)?")


@checked
def name_fingers(hand: Hand, names: Mapping[str, tuple[str, str]] | None = None) -> Hand:
    """Return the hand with its links named by finger and phalanx, as grips and their contributions need them.

    For links that are not in ``names``, names such as ``robot0:ffproximal``, ``index_distal_link`` or ``palm``
    decide; a thumb of three phalanges has a metacarpal, a proximal and a distal one. Other links keep their
    names, and take part in no grip that knows fingers.

    Args:
        hand: such as [`jaxgrasp.interop.hand_from_mujoco`][] reads.
        names: finger (thumb, index, middle, ring, little) and phalanx (palm, metacarpal, proximal, middle, distal) by
            the link's present name, such as ``{"link_3.0": ("index", "distal")}``.

    Raises:
        ValueError: for a name that the hand lacks, or a finger or phalanx that there is none of.
    """
    link_names = [link.name for link in hand.links]
    overrides = dict(names or {})
    for name, (finger, phalanx) in overrides.items():
        if name not in link_names:
            raise ValueError(f"names has {name!r}: expected links of the hand, such as {', '.join(link_names[:5])}")
        if finger not in FINGERS or phalanx not in (*PHALANGES, "metacarpal"):
            raise ValueError(
                f"names[{name!r}] is {(finger, phalanx)}: expected one of {', '.join(FINGERS)}, "
                f"and one of {', '.join((*PHALANGES, 'metacarpal'))}"
            )
    parsed = {name: overrides.get(name) or _parse_name(name) for name in link_names}
    if ("thumb", "middle") in parsed.values():
        shifted = {("thumb", "proximal"): ("thumb", "metacarpal"), ("thumb", "middle"): ("thumb", "proximal")}
        parsed = {
            name: pair if name in overrides or pair is None else shifted.get(pair, pair)
            for name, pair in parsed.items()
        }
    links = tuple(link if (pair := parsed[link.name]) is None else Link(*pair, link.joint) for link in hand.links)
    return Hand(**{**vars(hand), "links": links})


def _parse_name(name: str) -> tuple[str, str] | None:
    """Return the finger and phalanx in a link's name, or None where it has none."""
    text = name.rpartition(":")[2].lower().strip()
    if _PALM.fullmatch(text):
        return PALM
    match = _LINK.fullmatch(text)
    if match is None:
        return None
    finger, phalanx = (
        next(key for key, words in kinds.items() if match[group] in words)
        for group, kinds in (("finger", FINGERS), ("phalanx", PHALANGES))
    )
    return finger, "metacarpal" if (finger, phalanx) == ("thumb", "palm") else phalanx
