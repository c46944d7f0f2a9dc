"""Page of a single grasp, hand or object in three dimensions, which the reader can turn."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import jax
import numpy as np

from jaxgrasp.batch.chunk_statistics import cases_of
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.evaluation import Evaluation, evaluate
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary_text import times_harder
from jaxgrasp.files.replace import replace_file
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.hand.mesh import Mesh
from jaxgrasp.hand.posture_limits import check_posture
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.faults import Fault, GraspError, check_grasp
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.model.solution import Verdict, is_balanced
from jaxgrasp.report.bundle import page_html
from jaxgrasp.report.grasp_in_3d import Case, force_arrows, framed
from jaxgrasp.report.look import INK, MUTED, OBJECT_COLOUR, SKIN_COLOUR, degrees, method_title, number, table, text
from jaxgrasp.report.sections import figure_html
from jaxgrasp.report.surfaces import (
    DrawnSurface,
    link_surfaces,
    mesh_surface,
    move_surface,
    placed,
    pose_matrix,
    shape_surface,
)
from jaxgrasp.report.worst_cases import DrawnCases, cases_html
from jaxgrasp.validation.checked import checked

HAND_OPACITY, OBJECT_OPACITY = 0.4, 0.3
"""Contacts lie between hand and object: both let them be seen."""
LIGHT = {"ambient": 0.55, "diffuse": 0.7, "specular": 0.05, "roughness": 0.9}


@checked
def show(
    path: str | os.PathLike,
    grasp: Grasp | None = None,
    wrench: AnyArray | None = None,
    *,
    limits: Limits | None = None,
    method: Literal["A", "B"] = "B",
    forces: AnyArray | None = None,
    hand: Hand | None = None,
    posture: Posture | None = None,
    solid: Mesh | Shape | None = None,
    pose: Pose | None = None,
    title: str = "grasp",
) -> None:
    """Draw a grasp, a hand and an object, or some of them, as an HTML file that opens offline (extra ``report``).

    Args:
        path: the file to write; one that stands there is replaced.
        grasp: one grasp of n contacts, drawn with its normals and friction cones.
        wrench: what it must exert ``(6,)`` [N, N.m]: then both answers are found and drawn with their forces.
        limits: of the grasp.
        method: which closed form, and its optimum.
        forces: others to be drawn at the grasp's contacts ``(n, 3)`` [N].
        hand: drawn by the skin of its links, in ``posture``.
        posture: one posture of the hand.
        solid: the object, a [`jaxgrasp.hand.Mesh`][] or one of the shapes.
        pose: where the object's frame stands; as the world's where not given.
        title: the page's heading.

    Raises:
        GraspError: for the first entry of the grasp that cannot be used.
        ValueError: where there is nothing to draw, or arguments do not belong together.
        TypeError: for a shape that cannot be drawn, such as a plane.
        ImportError: plotly is not installed.
    """
    if (hand is None) != (posture is None):
        raise ValueError("hand and posture go together: pass both or neither")
    if grasp is None and (wrench is not None or forces is not None or limits is not None):
        raise ValueError("wrench, forces and limits belong to a grasp: pass a grasp too")
    around = [*_hand(hand, posture), *_object(solid, pose)]
    if grasp is None:
        if not around:
            raise ValueError("there is nothing to draw: pass a grasp, a hand in a posture, or an object")
        corners = np.concatenate([np.array([trace[axis] for axis in "xyz"], float).T for trace in around])
        body = f"<section>{figure_html('shown', framed(around, _middle(corners)))}</section>"
    else:
        checked_grasp = _checked(grasp)
        evaluation = None if wrench is None else _evaluated(checked_grasp, wrench, limits, method)
        sets, results = (
            (ContactSets.from_grasp(checked_grasp, np.zeros(6)), {})
            if evaluation is None
            else (evaluation.sets, evaluation.results)
        )
        case = cases_of(sets, results, method, [0], np.arange(1))[0]
        case["labels"] = {"name": title}
        if forces is not None:
            around += _given_forces(Case(case), np.asarray(forces, float))
        body = _body(case, evaluation, around)
    page = page_html(title, f"<header><h1>{text(title)}</h1></header>{body}", "page.js")
    replace_file(Path(path), lambda stream: stream.write(page.encode()))


def _body(case: dict, evaluation: Evaluation | None, around: Sequence[dict]) -> str:
    """Return the body of the page: the answers of the evaluation, if any, and the grasp within its surroundings."""
    drawn = DrawnCases(False)
    drawn.add(case, "this grasp")
    answers = "" if evaluation is None else f"<section><h2>The answers</h2>{_answers(evaluation)}</section>"
    return f'{answers}<section id="cases"><h2>In three dimensions</h2>{cases_html(drawn, around)}</section>'


def _answers(evaluation: Evaluation) -> str:
    """Return both verdicts in words, and the reason where the grasp does not hold."""
    reason = Reason(int(evaluation.why[0, 0]))
    rows = []
    for name, result in evaluation.results.items():
        verdict = Verdict(int(result.verdict[0, 0]))
        balances = bool(is_balanced(verdict))
        largest = float(np.linalg.norm(result.forces[:, 0], axis=-1).max())
        rows.append(
            [
                text(method_title(name)),
                verdict.name,
                degrees(float(result.margin[0, 0])) if balances else "",
                f"{number(largest)} N" if balances else "",
                f'<span class="wide">{text(verdict.advice)}</span>',
            ]
        )
    head = ["", "verdict", "smallest friction margin", "largest force", "<span class='wide'>what it means</span>"]
    sentence = f"It does not hold: {text(reason.title)}. {text(reason.advice)}"
    if reason == Reason.HOLDS:
        sentence = "It holds."
    elif reason == Reason.HARDER and evaluation.squeeze_factor is not None:
        factor = times_harder(float(evaluation.squeeze_factor[0, 0]))
        sentence = f"It holds if it squeezes {factor} times as hard. {text(reason.advice)}"
    return f"<p>{sentence}</p>{table(head, rows)}"


def _checked(grasp: Grasp) -> Grasp:
    if np.ndim(grasp.points) != 2:
        raise GraspError(Fault("points", (), f"an array of shape {np.shape(grasp.points)}", "one grasp, (n, 3)"))
    return check_grasp(jax.tree.map(lambda leaf: np.asarray(leaf, float), grasp))


def _evaluated(grasp: Grasp, wrench: AnyArray, limits: Limits | None, method: str) -> Evaluation:
    if np.shape(wrench) != (6,):
        raise GraspError(Fault("wrench", (), f"an array of shape {np.shape(wrench)}", "one wrench, (6,)"))
    dtype = "float64" if jax.config.read("jax_enable_x64") else "float32"
    batch, bounds = jax.tree.map(lambda leaf: np.asarray(leaf, float)[None], (grasp, limits))
    methods = (method, f"{method}-optimum")
    return evaluate(batch, np.asarray(wrench, float), limits=bounds, methods=methods, dtype=dtype)


def _given_forces(case: Case, forces: np.ndarray) -> list[dict]:
    if forces.shape != case.points.shape:
        raise ValueError(
            f"forces has shape {forces.shape}: expected {case.points.shape}, the shape of the grasp's points"
        )
    largest = float(np.linalg.norm(forces, axis=1).max())
    newtons = case.newtons if case.has_closed or case.has_optimum else case.newtons_for(largest)
    return force_arrows(case, "forces as given", forces, newtons, INK, 6)


def _hand(hand: Hand | None, posture: Posture | None) -> list[dict]:
    if hand is None or posture is None:
        return []
    check_posture(hand, posture)
    poses = pose_matrix(pose_hand(hand, posture).links)
    if poses.ndim != 3:
        raise ValueError(f"posture has angles of shape {np.shape(posture.angles)}: expected one posture")
    corners, faces, first = [], [], 0
    for link, at in zip(link_surfaces(hand), poses, strict=True):
        corners.append(placed(link.corners, at))
        faces.append(link.faces + first)
        first += len(link.corners)
    skin = DrawnSurface(np.concatenate(corners), np.concatenate(faces))
    return [_surface("hand", skin, SKIN_COLOUR, HAND_OPACITY)]


def _object(solid: Mesh | Shape | None, pose: Pose | None) -> list[dict]:
    if solid is None:
        if pose is not None:
            raise ValueError("pose is given without an object: pass solid=... too")
        return []
    surface = mesh_surface(solid) if isinstance(solid, Mesh) else shape_surface(solid)
    if pose is not None:
        surface = move_surface(surface, pose_matrix(pose))
    traces = [_surface("object", surface, OBJECT_COLOUR, OBJECT_OPACITY)]
    if len(surface.lines):
        line = {"type": "scatter3d", "mode": "lines", "name": "edges", "line": {"color": MUTED, "width": 2}}
        traces.append({**line, **_coordinates(surface.lines), "hoverinfo": "skip", "showlegend": False})
    return traces


def _surface(name: str, surface: DrawnSurface, colour: str, opacity: float) -> dict:
    triangles = dict(zip("ijk", surface.faces.T.tolist(), strict=True))
    look = {"color": colour, "opacity": opacity, "lighting": LIGHT, "hoverinfo": "skip", "showlegend": True}
    return {"type": "mesh3d", "name": name, **_coordinates(surface.corners), **triangles, **look}


def _coordinates(points: np.ndarray) -> dict:
    """Round coordinates to a micrometre; a gap is None."""
    columns = np.round(points, 6).T.tolist()
    return {axis: [None if v != v else v for v in column] for axis, column in zip("xyz", columns, strict=True)}


def _middle(corners: np.ndarray) -> np.ndarray:
    return (np.nanmin(corners, axis=0) + np.nanmax(corners, axis=0)) / 2
