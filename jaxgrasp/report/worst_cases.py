"""The worst cases of the report: a table to choose from, one scene at a time, and the forces of its contacts."""

import numpy as np

from jaxgrasp.batch.summary import Summary
from jaxgrasp.report.bundle import embedded
from jaxgrasp.report.grasp_in_3d import Case, scale_text, scene
from jaxgrasp.report.look import METHOD_COLOURS, counted, degrees, number, percentage, swatch, table, text


def worst_html(summary: Summary) -> str:
    """The whole section."""
    if not summary.worst:
        return (
            "<p class='note'>There is none to show: no closed form was compared with its optimum, or each one that was "
            "compared is the optimum.</p>"
        )
    cases = [Case(case) for case in summary.worst]
    several = summary.problems != summary.grasps
    name = cases[0].name
    choices = "".join(
        f'<option value="{i}">{i + 1}: {_title(case, several)}, price {percentage(case["price"])}</option>'
        for i, case in enumerate(summary.worst)
    )
    panels = "".join(
        _panel(i, case, data, several) for i, (case, data) in enumerate(zip(cases, summary.worst, strict=True))
    )
    warm, cool = swatch(METHOD_COLOURS[name]), swatch(METHOD_COLOURS[name + "-optimum"])
    intro = (
        f"The {counted(len(cases), 'problem')} of the highest price of friction, closed form {name} {warm} against its "
        f"optimum {cool}. Arrows are what the hand exerts on the object. Each cone holds the forces that friction "
        "allows: an arrow outside its cone slips, one that points away from it pulls. A price near 100% often means a "
        "wrench near the limit of what friction can hold, where the optimum has to squeeze hard."
    )
    return f"""<p class="note">{intro}</p>
{_overview(summary.worst, several)}
<div class="chooser"><button type="button" id="before" aria-label="previous case">&lsaquo;</button>
<select id="case" aria-label="case">{choices}</select>
<button type="button" id="after" aria-label="next case">&rsaquo;</button>
<span class="note">Drag to turn, scroll to zoom, hover for numbers, click the legend to hide.</span></div>
<div class="case"><div id="scene" class="figure"></div><div>{panels}</div></div>
{embedded("scenes", [scene(case) for case in cases])}"""


def _title(case: dict, several: bool) -> str:
    wrench = f", wrench {case['wrench_number']}" if several else ""
    return f"grasp {case['grasp']}{wrench}"


def _overview(cases: list[dict], several: bool) -> str:
    labels = list(dict.fromkeys(name for case in cases for name in case["labels"]))
    head = [
        "",
        "grasp",
        *(["wrench"] if several else []),
        *(f'<span class="label">{text(name)}</span>' for name in labels),
    ]
    head += ["contacts", "price of friction", "smallest friction margin", "largest cone violation"]
    rows = []
    for i, case in enumerate(cases):
        button = f'<button type="button" class="pick" data-case="{i}" aria-label="show case {i + 1}">{i + 1}</button>'
        row = [button, str(case["grasp"]), *([str(case["wrench_number"])] if several else [])]
        row += [f'<span class="label">{text(case["labels"].get(name, ""))}</span>' for name in labels]
        row += [
            str(len(case["points"])),
            percentage(case["price"]),
            degrees(case["margin"]),
            f"{number(case['violation'])} N",
        ]
        rows.append(row)
    return table(head, rows, "overview") + (
        "<p class='note'>Grasps are numbered from 0, in the order of the input. Margin: friction angle less slip "
        "angle, of the closed form's worst contact. Violation: its tangential force beyond friction's limit.</p>"
    )


def _panel(index: int, case: Case, data: dict, several: bool) -> str:
    """What is known of one case, beside its scene."""
    force, torque = case.wrench[:3], case.wrench[3:]
    facts = [
        f"<b>Wrench</b> force ({_vector(force)}) N, torque ({_vector(torque)}) N·m about the origin.",
        f"<b>Arrows</b> {scale_text(case)}",
        f"<b>Largest force</b> closed form {_largest(case.closed)} N, optimum {_largest(case.optimum)} N.",
    ]
    closed, optimum = case.angles(case.closed), case.angles(case.optimum)
    limit = np.arctan(case.friction)
    rows = [
        [
            str(i + 1),
            degrees(limit[i]),
            number(case.squeeze[i]),
            number(float(np.linalg.norm(case.closed[i]))),
            _slip(closed[i], limit[i]),
            number(float(np.linalg.norm(case.optimum[i]))),
            _slip(optimum[i], limit[i]),
        ]
        for i in range(len(case.points))
    ]
    warm, cool = swatch(METHOD_COLOURS[case.name]), swatch(METHOD_COLOURS[case.name + "-optimum"])
    head = [
        "contact",
        "friction angle",
        "squeeze [N]",
        *(f'<span class="name">{s}{t}</span>' for s in (warm, cool) for t in ("|f| [N]", "slip")),
    ]
    hidden = " hidden" if index else ""
    lines = "".join(f"<p>{fact}</p>" for fact in facts)
    title = f"<h3>Case {index + 1}: {_title(data, several)}</h3>"
    return f'<div class="panel" data-case="{index}"{hidden}>{title}{lines}{table(head, rows, "contacts")}</div>'


def _slip(slip: float, limit: float) -> str:
    if np.isnan(slip):
        return "no load"
    # An optimum's contact on the surface of its cone has the friction angle itself, to rounding.
    over = slip > limit + 1e-6
    return f'<span class="over">{degrees(slip)}</span>' if over else degrees(slip)


def _vector(vector: np.ndarray) -> str:
    return ", ".join(number(float(v)) for v in vector)


def _largest(forces: np.ndarray) -> str:
    return number(float(np.linalg.norm(forces, axis=1).max()))
