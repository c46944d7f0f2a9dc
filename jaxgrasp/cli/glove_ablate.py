"""``jaxgrasp glove ablate``: which of a glove's joints matter for a scene."""

from collections.abc import Iterable, Sequence

from jaxgrasp.cli.glove_arguments import Ablate
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.csv_rows import write_rows
from jaxgrasp.files.replace import check_writable
from jaxgrasp.glove.model import load_glove, lrp_hand_master
from jaxgrasp.grip.scene_file import load_scene, scene_path
from jaxgrasp.lab.ablation import JointLoss, joint_losses
from jaxgrasp.lab.loaded_scene import loaded_scene
from jaxgrasp.world.world_file import world_of


def ablate_command(arguments: Ablate) -> int:
    """Print the loss without each joint of the glove, and write the same table as CSV if asked for."""
    if arguments.trials is not None:
        return _ablate_over_trials(arguments, arguments.trials)
    file = load_scene(scene_path(arguments.scene))
    model = lrp_hand_master() if arguments.model is None else load_glove(arguments.model)
    if arguments.out is not None:
        check_writable(arguments.out.parent)
    set_up_jax("float64")
    with compiling("the hand and its contacts"):
        gripped = loaded_scene(file)
        losses = joint_losses(gripped, model, world_of(file, gripped) if file.other else None)
    show(f"{file.name}: without one of the glove's joints")
    show(f"{'joint':18s} {'mN m not felt':>14s} {'of what is felt':>16s} {'contacts':>9s} {'squeeze':>8s}  holds")
    for loss in losses:
        numbers = f"{1e3 * loss.torque:14.1f} {loss.torque_share:16.1%} {-loss.contacts:+9d} {-loss.squeeze:+8.1%}"
        show(f"{loss.joint:18s} {numbers}  {'yes' if loss.holds else 'no'}")
    if arguments.out is not None:
        write_rows(arguments.out, _rows(losses))
        show(f"written: {arguments.out}")
    return 0


def _ablate_over_trials(arguments: Ablate, count: int) -> int:
    """Print the part of what is felt that each joint renders over whole trials, and how stable the order is."""
    if count < 3:
        raise ValueError(f"trials is {count}: expected 3 or more, to tell how stable the order is")
    if arguments.scene != Ablate.scene:
        raise ValueError(f"scene is {arguments.scene!r}, beside trials: trials are of the tasks peg and stack")
    # The teleoperation needs MuJoCo, which other uses of this command do not.
    from jaxgrasp.teleop.importance import rank_joints
    from jaxgrasp.teleop.trial import record_torques

    model = lrp_hand_master() if arguments.model is None else load_glove(arguments.model)
    if arguments.out is not None:
        check_writable(arguments.out.parent)
    set_up_jax("float64")
    with compiling("both hands, and playing the trials"):
        ranking = rank_joints(model.joints, record_torques(model, count))
    show(f"{count} trials: the part of what is felt that each of the glove's joints renders")
    show(f"{'joint':18s} {'share':>7s}  95 % interval")
    rows = [["joint", "share", "low", "high"]]
    for joint, share, low, high in zip(ranking.joints, ranking.shares, ranking.low, ranking.high, strict=True):
        show(f"{joint:18s} {share:7.1%}  {low:.1%} to {high:.1%}")
        rows.append([joint, f"{share:.6g}", f"{low:.6g}", f"{high:.6g}"])
    show(
        f"order from trial to trial: Kendall's tau {ranking.tau:.2f} in the mean, {ranking.tau_low:.2f} to "
        f"{ranking.tau_high:.2f}"
    )
    if arguments.out is not None:
        write_rows(arguments.out, rows)
        show(f"written: {arguments.out}")
    return 0


def _rows(losses: list[JointLoss]) -> Iterable[Sequence]:
    yield ["joint", "torque [N.m]", "share felt", "contacts lost", "squeeze lost", "holds"]
    for loss in losses:
        yield [loss.joint, *(f"{x:.6g}" for x in loss[1:5]), int(loss.holds)]
