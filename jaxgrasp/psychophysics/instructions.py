"""Texts for a person: a screen before the first trial, and a hint where nothing was felt."""

from jaxgrasp.psychophysics.plan import QUESTIONS, Plan

MOVEMENTS = {
    "weight": "Hold your hand with the palm up. Bend your fingers at the knuckles to lift the weight, by up to 4 cm,\n"
    "and let it down again.",
    "stiffness": "Bend your fingers at the knuckles to squeeze the object against your thumb, by up to 1 cm,\n"
    "and open them again.",
    "torque": "Bend your {joint} joint to and fro; something resists it.",
}
OBJECT_NOUNS = {"weight": "weight", "stiffness": "object", "torque": "resistance"}
HINTS = {
    "weight": "Bend your fingers until they lift the weight, let it down, and lift it again.",
    "stiffness": "Bend your fingers until they squeeze the object, open them, and squeeze again.",
    "torque": "Bend your {joint} joint to and fro.",
}


def instructions(plan: Plan) -> str:
    """Return the plan's own instructions, or those for its stimulus, its task and its durations."""
    if plan.session.instructions:
        return plan.session.instructions
    noun = OBJECT_NOUNS[plan.stimulus.kind]
    lines = [f"You wear a glove in which you feel a {noun} that is not there.", "", _movement(plan, MOVEMENTS), ""]
    if plan.method == "matching":
        lines += [
            f"In each trial you feel a first {noun}, and then another one, which you make stronger or weaker until",
            "both feel the same.",
        ]
    else:
        lines += [
            f"In each trial you feel two of them, one after the other{_how_long(plan)}.",
            f"Then say which one was {QUESTIONS[plan.stimulus.kind]}: type 1 or 2, then Enter.",
            "If you cannot tell, guess.",
        ]
        if not plan.session.duration:
            lines.append("Take your time, and move as often as you like.")
    if plan.session.practice:
        lines += ["", f"Practice comes first: trials 1 to {plan.session.practice}."]
    lines += ["", "You may stop at any time, and need not say why."]
    return "\n".join(lines)


def hint(plan: Plan) -> str:
    """Return the hint for a hand that did not move: the plan's own, or that for its stimulus."""
    return plan.session.hint or _movement(plan, HINTS)


def _movement(plan: Plan, texts: dict[str, str]) -> str:
    return texts[plan.stimulus.kind].format(joint=plan.stimulus.joint)


def _how_long(plan: Plan) -> str:
    return f", each for {plan.session.duration:g} s" if plan.session.duration else ""
