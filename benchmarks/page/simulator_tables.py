"""The page of the simulated hands in Markdown, from the report that the JSON holds too."""

from benchmarks.page.tables import table

ROWS = {
    "step": "one step of the simulator",
    "contacts": "contacts, loads and forces (`from_mujoco_warp`)",
    "closed form": "closed form (`closed_form`)",
    "optimum": "constrained optimum and verdict (`constrained_optimum`)",
    "hold margin": "the margin as a reward (`hold_margin`)",
}


def page(report: dict) -> str:
    facts, worlds, times = report["machine"], report["plan"]["worlds"], report["times"]
    versions = facts["versions"] | {"warp": times["warp"]}
    named = ", ".join(f"{name} {versions[name]}" for name in ("jax", "mujoco", "warp"))
    median, first = times["median_s"], times["first_s"]
    rows = [
        [text, f"{1e3 * median[key]:.3g}", f"{worlds / median[key]:,.0f}", f"{first[key]:.3g}" if key in first else ""]
        for key, text in ROWS.items()
    ]
    to_verdict, to_margin = (median["contacts"] + median[key] for key in ("optimum", "hold margin"))
    counts = ", ".join(f"{count:,} with {n}" for n, count in enumerate(times["contacts"]) if count)
    plan = report["plan"]
    parts = [
        "# Thousands of simulated hands: from contacts to verdicts",
        f"Made by `python -m benchmarks.simulators`. {facts['processor']}, {facts['cores']} cores, {facts['system']}, "
        f"Python {facts['python']}, {named}, float32; Warp's device is the processor too.",
        f"{worlds:,} worlds in MuJoCo Warp: a hand of three fingers with two joints each, a ball, a table. In every "
        f"other world the ball lay some 3 cm beside the middle before the last {plan['steps']} steps. Worlds by their "
        f"contacts of the hand: {counts}; those of the table do not count. The optimum holds the ball's weight in "
        f"{times['held']:,} worlds, and the margin is positive in {times['positive_margins']:,}. Medians of up to "
        f"{plan['repeats']} turns in one process, in which the calls alternate; the first call of each compiles.",
        table(["", f"ms for {worlds:,} worlds", "worlds a second", "first call [s]"], rows),
        f"From contacts to verdicts: {worlds / to_verdict:,.0f} worlds a second, in {to_verdict / median['step']:.0%} "
        f"of a step's time. From contacts to margins: {worlds / to_margin:,.0f}, in {to_margin / median['step']:.0%}.",
    ]
    return "\n\n".join(parts) + "\n"
