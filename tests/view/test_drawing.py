"""Drawing and description of a grasp, without a viewer."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip.monitor import Assessment, Hold, Touch
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict
from jaxgrasp.report.look import TOUCH_COLOURS, VERDICT_TITLES
from jaxgrasp.view.drawing import LONGEST, NOTHING, SHORTEST, PosedHand, SolvedGrasp, drawing, fitting, rgb
from jaxgrasp.view.panel_words import bars_html, contacts_html, headline, torques_html, words_html

NORMALS = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1]])
NOTHING_PROVEN = np.zeros(6)
FORCES = np.array([[2.0, 0, 0.5], [-2, 0, 0.5], [0, 0, 0]])


def answer(verdict: Verdict, forces: np.ndarray, certificate: np.ndarray = NOTHING_PROVEN) -> Solution:
    numbers = {
        "forces": forces,
        "multiplier": np.zeros(6),
        "residual": 0.0,
        "objective": 0.0,
        "certificate": certificate,
        "force_bound": 1e9 if verdict == Verdict.INFEASIBLE else 0.0,
    }
    codes = {"verdict": int(verdict), "steps": 0, "route": 0, "rank": 6}
    return Solution(**{name: jnp.asarray(value) for name, value in (numbers | codes).items()})


def solved_grasp(
    closed=Verdict.OUTSIDE_CONES, optimum=Verdict.OPTIMAL, law="optimum", hold=Hold.STABLE, **changes
) -> SolvedGrasp:
    certificate = np.array([0, 0, 1.0, 0, 0, 0]) if optimum == Verdict.INFEASIBLE else NOTHING_PROVEN
    answers = answer(closed, FORCES), answer(optimum, 0.9 * FORCES, certificate)
    touches = np.array([Touch.HOLDS, Touch.HOLDS, Touch.ABSENT])
    disagrees = np.asarray(optimum == Verdict.OPTIMAL and closed == Verdict.OUTSIDE_CONES)
    fields = {
        "grasp": Grasp(0.03 * NORMALS, NORMALS, np.full(3, 0.5), np.full(3, 2.0), present=np.array([1.0, 1, 0])),
        "origin": np.array([0.1, 0.2, 0.3]),
        "wrench": np.array([0, 0, 1.0, 0, 0, 0]),
        "assessment": Assessment(
            *answers, jnp.asarray(int(hold)), jnp.asarray(touches), answers[1].forces, None, jnp.asarray(disagrees)
        ),
        "margins": (np.array([-0.1, 0.2, np.inf]), np.array([0.0, 0.2, np.inf])),
        "closed_touches": np.array([Touch.SLIDES, Touch.HOLDS, Touch.ABSENT]),
        "law": law,
        "names": ("thumb <b>", "index", "middle"),
        "object_pose": np.eye(3, 4),
    }
    return SolvedGrasp(**fields | changes)


def test_forces_are_drawn_to_scale_at_the_contacts_that_there_are():
    what = solved_grasp()
    drawn = drawing(what)
    for (name, arrow_set), share in zip(drawn.forces.items(), (1.0, 0.9)):
        lengths = arrow_set.shafts.scales[:, 2] + arrow_set.heads.scales[:, 2]
        expected = share * np.linalg.norm(FORCES, axis=1) * drawn.scale.metres
        np.testing.assert_allclose(lengths[:2], expected[:2], err_msg=name)
        assert lengths[2] <= 2 * NOTHING
        np.testing.assert_allclose(arrow_set.shafts.positions[:2], what.points[:2])
    assert (drawn.contacts.scales[:2] > NOTHING).all() and (drawn.contacts.scales[2] == NOTHING).all()


def test_what_pulls_is_drawn_against_what_must_be_exerted():
    load = drawing(solved_grasp()).load
    tip = load.heads.positions[0] - load.shafts.positions[0]
    assert tip[2] < 0 and np.allclose(tip[:2], 0)


def test_contacts_have_the_colours_of_the_reports():
    np.testing.assert_array_equal(drawing(solved_grasp()).cones.colours[0], rgb(TOUCH_COLOURS[Touch.HOLDS]))
    escapes = drawing(solved_grasp(optimum=Verdict.INFEASIBLE, hold=Hold.SLIPPING))
    # The law that is applied has no forces: what the closed form does is what there is to be seen.
    np.testing.assert_array_equal(escapes.cones.colours[0], rgb(TOUCH_COLOURS[Touch.SLIDES]))


def test_forces_that_balance_nothing_are_not_drawn_and_the_object_escapes_along_minus_the_certificate():
    escaping = solved_grasp(optimum=Verdict.INFEASIBLE, hold=Hold.SLIPPING)
    drawn = drawing(escaping)
    assert drawn.forces["B-optimum"].shafts.scales.max() <= NOTHING
    assert drawn.forces["B"].shafts.scales[:2, 2].min() > 1e-3
    np.testing.assert_array_equal(escaping.escape, [0, 0, -1, 0, 0, 0])
    assert solved_grasp().escape is None


def test_a_scale_stays_while_it_serves():
    scale = None
    for newtons in np.geomspace(1e-3, 1e3, 60):
        before, scale = scale, fitting(scale, {"B": np.array([[newtons, 0, 0]])})
        length = scale.metres * newtons
        assert SHORTEST <= length <= LONGEST
        if before is not None and SHORTEST <= before.metres * newtons <= LONGEST:
            assert scale is before
    assert fitting(scale, {"B": np.zeros((2, 3))}) is scale


@pytest.mark.parametrize(
    "what, says",
    [
        (solved_grasp(), "It holds, though the closed form slips"),
        (solved_grasp(Verdict.CLOSED_FORM_OPTIMAL, Verdict.CLOSED_FORM_OPTIMAL), "It holds"),
        (solved_grasp(law="closed-form", hold=Hold.SLIPPING), "It slips, though other forces would hold it"),
        (solved_grasp(optimum=Verdict.INFEASIBLE, hold=Hold.SLIPPING), "It escapes: no forces hold it"),
        (solved_grasp(optimum=Verdict.NO_CONTACTS, hold=Hold.LOST), "Nothing touches it"),
        (solved_grasp(optimum=Verdict.INFEASIBLE, hold=Hold.SLIPPING, rests=True), "It stands on the table"),
    ],
)
def test_headlines(what, says):
    assert headline(what) == says


def test_verdicts_margins_and_advice_are_said_for_both_laws():
    words = words_html(solved_grasp(), drawing(solved_grasp()).scale)
    for verdict in (Verdict.OUTSIDE_CONES, Verdict.OPTIMAL):
        assert VERDICT_TITLES[verdict] in words and verdict.advice in words
    assert "smallest friction margin \N{MINUS SIGN}5.7\N{DEGREE SIGN} (thumb &lt;b&gt;)" in words
    assert "<b>" not in words
    table = contacts_html(solved_grasp())
    assert "thumb &lt;b&gt;" in table and "middle" not in table


def test_bars_go_to_the_side_of_their_torque():
    left, right = bars_html(["index MP", "thumb MP"], np.array([-0.2, 0.1])).split("thumb MP")
    assert "left:0.0%;width:50.0%" in left and "left:50.0%;width:25.0%" in right
    assert torques_html(solved_grasp()) == ""
    hand = PosedHand(np.zeros((1, 3, 4)), ("index MP",), np.array([np.nan]))
    assert "nan" in torques_html(replace_hand(hand))


def replace_hand(hand: PosedHand) -> SolvedGrasp:
    return solved_grasp()._replace(hand=hand)


def test_a_margin_of_nothing_but_rounding_is_zero():
    tiny = solved_grasp()._replace(margins=(np.array([-1e-15, 0.2, np.inf]),) * 2)
    assert "margin 0.0" in words_html(tiny, drawing(tiny).scale)
