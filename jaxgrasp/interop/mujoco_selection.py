"""Bodies, geoms and flexes of a MuJoCo or MJX model by name, and the contacts that ``hand=``, ``exclude=`` select."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import mujoco
    from mujoco import mjx

KINDS = ("body", "geom", "flex")
"""Kinds of named elements, in the order in which a name is looked up."""
LISTED = 11
"""Names that an error lists at most."""


@dataclass(frozen=True)
class ModelTree:
    """Bodies of a model and the shapes on them; shapes are numbered geoms first, then flexes."""

    parents: np.ndarray
    """``(nbody,)``: id of each body's parent."""
    welds: np.ndarray
    """``(nbody,)``: id of the topmost body that each body is welded to; 0 where it cannot move."""
    geom_bodies: np.ndarray
    """``(ngeom,)``: id of each geom's body."""
    flex_bodies: tuple[np.ndarray, ...]
    """Ids of the bodies that carry each flex's vertices or nodes."""
    find: Callable[[str, str], int]
    """Return the id of an element by kind and name; -1 where the model has none."""
    name_of: Callable[[str, int], str]
    """Return the name of an element by kind and id; ``""`` where it has none."""

    def subtree(self, root: int) -> np.ndarray:
        """Return ``(nbody,)`` booleans: a body and all bodies below it."""
        inside = np.zeros(len(self.parents), bool)
        inside[root] = True
        for body in range(root + 1, len(inside)):
            # MuJoCo numbers parents before their children.
            inside[body] = inside[self.parents[body]]
        return inside

    def shapes_of(self, bodies: np.ndarray) -> np.ndarray:
        """Return booleans: the geoms of these bodies, and the flexes all of whose vertices these bodies carry."""
        flexes = [len(carriers) > 0 and bodies[carriers].all() for carriers in self.flex_bodies]
        return np.concatenate([bodies[self.geom_bodies], np.array(flexes, bool)])

    def link_name(self, shape: int) -> str:
        """Return the name of a shape's link: the geom's body, or the flex; such as ``"body 7"`` without a name."""
        n_geoms = len(self.geom_bodies)
        if shape >= n_geoms:
            return self.name_of("flex", shape - n_geoms) or f"flex {shape - n_geoms}"
        return self.body_name(int(self.geom_bodies[shape]))

    def body_name(self, body: int) -> str:
        """Return the name of a body; ``"body 7"`` without a name."""
        return self.name_of("body", body) or f"body {body}"

    def object_root(self, body: str | int) -> int:
        """Return the id of the topmost body that a movable body is welded to.

        Raises:
            ValueError: for an unknown body, or one that cannot move.
        """
        if isinstance(body, str):
            index = self.find("body", body) if body else -1
            if index < 0:
                listed = ", ".join(self.body_name(i) for i in range(1, min(len(self.parents), LISTED + 1)))
                more = ", ..." if len(self.parents) > LISTED + 1 else ""
                raise ValueError(f"body is {body!r}: expected a body of this model, such as {listed}{more}")
        else:
            index = self._check_body_id("body", body)
        if self.welds[index] == 0:
            raise ValueError(f"body is {body!r}, which cannot move: expected a body that contacts hold")
        return int(self.welds[index])

    def shapes_named(self, field: str, name: str | int) -> np.ndarray:
        """Return booleans: the shapes of a body's subtree, a geom or a flex.

        The world's body stands for its own geoms alone, since everything hangs on it.

        Raises:
            ValueError: for a name that the model lacks, an id that is out of range, or a name of both a body and a geom
                or flex outside of that body.
        """
        if not isinstance(name, str):
            return self._body_shapes(self._check_body_id(field, name))
        # MJX would take the empty name for that of an element without any.
        ids = {kind: self.find(kind, name) if name else -1 for kind in KINDS}
        masks = []
        if ids["body"] >= 0:
            masks.append(self._body_shapes(ids["body"]))
        for kind, offset in (("geom", 0), ("flex", len(self.geom_bodies))):
            if ids[kind] >= 0:
                masks.append(np.arange(self.n_shapes) == offset + ids[kind])
        if not masks:
            raise ValueError(f"{field} is {name!r}: expected a body, geom or flex of this model{self._alike(name)}")
        if any((mask & ~masks[0]).any() for mask in masks[1:]):
            named = " and a ".join(kind for kind in KINDS if ids[kind] >= 0)
            raise ValueError(f"{field} is {name!r}, the name of a {named}: rename one, or give the id of a body")
        return masks[0]

    @property
    def n_shapes(self) -> int:
        """Return the number of geoms and flexes."""
        return len(self.geom_bodies) + len(self.flex_bodies)

    def _body_shapes(self, body: int) -> np.ndarray:
        return self.shapes_of(self.subtree(body) if body else np.arange(len(self.parents)) == 0)

    def _check_body_id(self, field: str, body: Any) -> int:
        if isinstance(body, bool) or not isinstance(body, int | np.integer):
            raise ValueError(f"{field} is {body!r}: expected a name or the id of a body")
        if not 0 <= body < len(self.parents):
            raise ValueError(f"{field} is {body!r}: expected an id from 0 to {len(self.parents) - 1}")
        return int(body)

    def _alike(self, name: str) -> str:
        """Return a hint at the most similar name of the model, else at its first bodies."""
        counts = zip(KINDS, (len(self.parents), len(self.geom_bodies), len(self.flex_bodies)), strict=True)
        names = [self.name_of(kind, i) for kind, count in counts for i in range(count)]
        names = [candidate for candidate in dict.fromkeys(names) if candidate]
        alike = difflib.get_close_matches(name, names, 1, 0.5)
        if alike:
            return f"; did you mean {alike[0]!r}?"
        return f", such as {', '.join(names[:LISTED])}" + (", ..." if len(names) > LISTED else "")


Element = str | int
"""A body, geom or flex by name, or a body by id."""
Exclude = Element | Sequence[Element | tuple[Element, Element]]
"""Elements or pairs of elements whose contacts do not count."""


@dataclass(frozen=True)
class ContactSelection:
    """Shapes of the object, of the hand, and those whose contacts are left out."""

    is_object: np.ndarray
    """Booleans by shape: the object's."""
    hand: np.ndarray
    """Booleans by shape: those whose contacts count, the object's among them."""
    pairs: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Booleans by shape, of the two sides of pairs that do not count."""

    def is_touching(self, first: Any, second: Any, xp: Any = np) -> Any:
        """Return booleans: contacts between the object and something else, not between its own parts."""
        is_object = xp.asarray(self.is_object)
        return is_object[first] != is_object[second]

    def is_selected(self, first: Any, second: Any, xp: Any = np) -> Any:
        """Return booleans: contacts of the object that count; of shapes by number, with NumPy or ``xp=jax.numpy``."""
        hand = xp.asarray(self.hand)
        selected = self.is_touching(first, second, xp) & hand[first] & hand[second]
        for pair in self.pairs:
            first_side, second_side = map(xp.asarray, pair)
            selected = selected & ~(
                (first_side[first] & second_side[second]) | (second_side[first] & first_side[second])
            )
        return selected


def select_contacts(
    tree: ModelTree, body: Element, is_object: np.ndarray, hand: Element | Sequence[Element] | None, exclude: Exclude
) -> ContactSelection:
    """Return which contacts of an object count.

    Args:
        tree: bodies and shapes of the model.
        body: the object as the user named it, for messages.
        is_object: booleans by shape: the object's.
        hand: elements whose contacts count; all that do not belong to the object where it is None.
        exclude: elements, or pairs of elements, whose contacts do not count.

    Raises:
        ValueError: for an unknown name, a hand that is part of the object or has no geom, an exclusion that would leave
            no contact, or a pair without a part of the object or without anything else.
    """
    allowed = np.ones(tree.n_shapes, bool)
    if hand is not None:
        elements = _elements(hand)
        if not elements:
            raise ValueError("hand is empty: name the hand's bodies or geoms, or leave hand= out to count all contacts")
        allowed = is_object.copy()
        for field, element in _fields("hand", hand, elements):
            shapes = tree.shapes_named(field, element)
            if not shapes.any():
                raise ValueError(f"{field} is {element!r}: neither it nor a body below it has a geom that could touch")
            if not (shapes & ~is_object).any():
                raise ValueError(f"{field} is {element!r}, a part of body {body!r}: expected the hand that holds it")
            allowed |= shapes
    pairs = []
    for field, element in _fields("exclude", exclude, _elements(exclude)):
        if isinstance(element, tuple | list):
            pairs.append(_pair(tree, field, element, body, is_object))
            continue
        shapes = tree.shapes_named(field, element)
        if (shapes >= is_object).all():
            # A subtree that the object hangs in stands for the rest of it.
            shapes = shapes & ~is_object
            if not shapes.any():
                raise ValueError(f"{field} is {element!r}: no contact of body {body!r} would be left")
        pairs.append((shapes, np.ones(tree.n_shapes, bool)))
    return ContactSelection(is_object, allowed, tuple(pairs))


def _pair(
    tree: ModelTree, field: str, pair: Sequence[Any], body: Element, is_object: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the shapes of both sides of a pair that does not count."""
    if len(pair) != 2:
        raise ValueError(f"{field} is {pair!r}: expected a name, the id of a body, or a pair of these")
    first, second = (tree.shapes_named(f"{field}[{i}]", element) for i, element in enumerate(pair))
    if not ((first & is_object).any() and (second & ~is_object).any()) and not (
        (second & is_object).any() and (first & ~is_object).any()
    ):
        raise ValueError(f"{field} is {tuple(pair)!r}: expected a part of body {body!r} and something outside of it")
    return first, second


def _elements(selection: Any) -> list:
    """Return the elements of a single one or of a sequence."""
    return list(selection) if isinstance(selection, Sequence) and not isinstance(selection, str) else [selection]


def _fields(name: str, selection: Any, elements: list) -> list[tuple[str, Any]]:
    """Return each element with the words that name it in an error."""
    alone = not isinstance(selection, Sequence) or isinstance(selection, str)
    return [(name if alone else f"{name}[{i}]", element) for i, element in enumerate(elements)]


def listed(names: Sequence[str]) -> str:
    """Return names in quotation marks, each once."""
    return ", ".join(repr(name) for name in dict.fromkeys(names))


def tree_of_mujoco(mujoco: Any, model: mujoco.MjModel) -> ModelTree:
    """Return the bodies and shapes of a MuJoCo model."""
    kinds = _kinds(mujoco)
    return ModelTree(
        parents=np.asarray(model.body_parentid),
        welds=np.asarray(model.body_weldid),
        geom_bodies=np.asarray(model.geom_bodyid),
        flex_bodies=tuple(_flex_bodies(model, flex) for flex in range(model.nflex)),
        find=lambda kind, name: mujoco.mj_name2id(model, kinds[kind], name),
        name_of=lambda kind, index: mujoco.mj_id2name(model, kinds[kind], index) or "",
    )


def tree_of_mjx(mujoco: Any, model: mjx.Model) -> ModelTree:
    """Return the bodies and geoms of a model in MJX, which has no flexes."""
    from mujoco import mjx

    kinds = _kinds(mujoco)
    return ModelTree(
        parents=np.asarray(model.body_parentid),
        welds=np.asarray(model.body_weldid),
        geom_bodies=np.asarray(model.geom_bodyid),
        flex_bodies=(),
        find=lambda kind, name: -1 if kind == "flex" else mjx.name2id(model, kinds[kind], name),
        name_of=lambda kind, index: mjx.id2name(model, kinds[kind], index) or "",
    )


def _kinds(mujoco: Any) -> dict[str, Any]:
    kinds = mujoco.mjtObj
    return {
        "body": kinds.mjOBJ_BODY,
        "geom": kinds.mjOBJ_GEOM,
        "flex": kinds.mjOBJ_FLEX,
        "joint": kinds.mjOBJ_JOINT,
        "equality": kinds.mjOBJ_EQUALITY,
    }


def _flex_bodies(model: mujoco.MjModel, flex: int) -> np.ndarray:
    """Return the ids of the bodies that carry a flex: of its nodes where it is interpolated, else of its vertices."""
    if model.flex_interp[flex]:
        start, count, bodies = model.flex_nodeadr[flex], model.flex_nodenum[flex], model.flex_nodebodyid
    else:
        start, count, bodies = model.flex_vertadr[flex], model.flex_vertnum[flex], model.flex_vertbodyid
    return np.unique(bodies[start : start + count])
