"""PyTorch has JAX's forces, margins and derivatives, in shared memory; PyTorch's own finite differences judge them."""

import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.interop import torch as grasp_torch

torch = pytest.importorskip("torch")
KINDS = pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=["float64", "float32"])
GRAVITY = 9.81


def pinch(dtype=torch.float64, batch: tuple[int, ...] = (), seed: int = 0) -> dict:
    """Return three fingers around a cylinder, a little different each, that hold 300 g; cones are active."""
    rng = np.random.default_rng(seed)
    angles = np.array([0.0, 2.1, 4.2]) + 0.05 * rng.normal(size=(*batch, 3))
    outward = np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1)
    values = {
        "points": 0.05 * outward + 0.002 * rng.normal(size=(*batch, 3, 3)),
        "normals": -outward,
        "friction": 0.28 + 0.05 * rng.uniform(size=(*batch, 3)),
        "squeeze": np.broadcast_to([4.0, 3.0, 3.0], (*batch, 3)) + 0.1 * rng.normal(size=(*batch, 3)),
        "wrench": np.broadcast_to([0.0, 0.0, 0.3 * GRAVITY, 0.0, 0.0, 0.0], (*batch, 6)) + 0.0,
    }
    return {name: torch.tensor(value, dtype=dtype) for name, value in values.items()}


def arrays(tensors: dict) -> tuple[Grasp, jnp.ndarray]:
    leaves = {name: jnp.asarray(value.numpy()) for name, value in tensors.items()}
    wrench = leaves.pop("wrench")
    return Grasp(**leaves), wrench


@pytest.mark.parametrize(
    ("dtype", "batch"), [(torch.float64, ()), pytest.param(torch.float32, (2, 2), marks=pytest.mark.slow)], ids=str
)
@pytest.mark.parametrize("method", ["constrained_optimum", "closed_form"])
def test_forces_are_jaxgrasps(dtype, batch, method):
    tensors = pinch(dtype, batch)
    solution = getattr(grasp_torch, method)(**tensors)
    assert (
        solution.forces.dtype == dtype and solution.forces.shape == (*batch, 3, 3) and solution.verdict.shape == batch
    )
    grasp, wrench = arrays(tensors)
    expected = getattr(jaxgrasp, method)(grasp, wrench)
    tolerance = 1e-9 if dtype == torch.float64 else 2e-4
    np.testing.assert_allclose(solution.forces, expected.forces, atol=tolerance)
    np.testing.assert_array_equal(solution.verdict, expected.verdict)
    # By a sum of our own, they exert the wrench.
    exerted = torch.cat([solution.forces.sum(-2), torch.linalg.cross(tensors["points"], solution.forces).sum(-2)], -1)
    torch.testing.assert_close(exerted, tensors["wrench"], atol=tolerance, rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["constrained_optimum", "closed_form"])
def test_gradients_of_forces_by_pytorchs_own_check(method):
    tensors = {name: value.requires_grad_() for name, value in pinch(batch=(2,)).items()}
    solution = getattr(grasp_torch, method)(**tensors)
    assert (
        solution.verdict <= int(Verdict.OPTIMAL) if method == "constrained_optimum" else solution.verdict >= 0
    ).all()
    if method == "constrained_optimum":
        apart = torch.linalg.vector_norm(solution.forces - grasp_torch.closed_form(**tensors).forces)
        assert apart > 0.1  # Cones are active, or this would be the closed form's derivative.

    def forces(points, normals, *others):
        # A unit normal has to stay one, as PyTorch moves its entries one by one.
        unit = normals / torch.linalg.vector_norm(normals, dim=-1, keepdim=True)
        return getattr(grasp_torch, method)(points, unit, *others).forces

    assert torch.autograd.gradcheck(forces, tuple(tensors.values()), eps=1e-6, atol=1e-5, rtol=1e-4)


@pytest.mark.slow
def test_gradients_of_margins_by_pytorchs_own_check():
    """Low friction and normals that all lean one way, so that how far a wrench may go is bounded by the cones."""
    tensors = pinch(batch=(2,))
    points, friction = tensors["points"].requires_grad_(), (0.2 * tensors["friction"]).requires_grad_()
    leaning = tensors["normals"] + torch.tensor([0.0, 0.0, -0.6], dtype=torch.float64)
    normals = leaning / torch.linalg.vector_norm(leaning, dim=-1, keepdim=True)
    pushes = torch.tensor([3.0, 1.0, 2.0], dtype=torch.float64)[:, None] * normals
    torques = torch.linalg.cross(points.detach(), pushes)
    wrench = torch.cat([pushes.sum(-2), torques.sum(-2)], -1).requires_grad_()
    direction = torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], dtype=torch.float64).repeat(2, 1)

    def margin(points, friction, wrench):
        return grasp_torch.wrench_margin(points, normals, friction, wrench, direction)

    leaves = [jnp.asarray(tensor.detach().numpy()) for tensor in (points, normals, friction, 1 + 0 * friction)]
    expected = jaxgrasp.wrench_margin(Grasp(*leaves), wrench.detach().numpy(), direction.numpy())
    assert (np.isfinite(expected) & (expected > 0)).all()
    np.testing.assert_allclose(margin(points, friction, wrench).detach(), expected, rtol=1e-9)
    assert torch.autograd.gradcheck(margin, (points, friction, wrench), eps=1e-6, atol=1e-5, rtol=1e-4)


def test_the_papers_margin_is_the_angle_that_is_left():
    tensors = pinch(batch=(2,))
    turn = torch.tensor([0.1, 0.3, 0.7], dtype=torch.float64)
    across = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    forces = 2 * (torch.cos(turn)[:, None] * tensors["normals"] + torch.sin(turn)[:, None] * across)
    margin = grasp_torch.stability_margin(tensors["normals"], forces)
    torch.testing.assert_close(margin, (torch.pi / 2 - turn).expand(2, 3))
    assert torch.autograd.gradcheck(
        lambda forces: grasp_torch.stability_margin(tensors["normals"], forces), (forces.requires_grad_(),), atol=1e-5
    )


@pytest.mark.slow
def test_only_what_asks_for_a_gradient_has_one_and_numbers_do_for_tensors():
    tensors = pinch()
    tensors["squeeze"].requires_grad_()
    tensors["friction"] = 0.3
    solution = grasp_torch.constrained_optimum(**tensors)
    solution.forces.square().sum().backward()
    assert tensors["squeeze"].grad.shape == (3,) and tensors["points"].grad is None
    assert not solution.verdict.requires_grad
    full = {**pinch(), "friction": torch.full((3,), 0.3, dtype=torch.float64)}
    torch.testing.assert_close(solution.forces.detach(), grasp_torch.constrained_optimum(**full).forces)


@pytest.mark.slow
def test_a_loss_that_masks_what_has_no_forces_has_finite_gradients():
    tensors = pinch(batch=(2,))
    tensors["friction"][1] = 0.0
    tensors["squeeze"].requires_grad_()
    solution = grasp_torch.constrained_optimum(**tensors)
    assert solution.verdict.tolist() == [int(Verdict.OPTIMAL), int(Verdict.INFEASIBLE)]
    solution.forces.square().sum((-2, -1))[solution.verdict < 2].sum().backward()
    assert tensors["squeeze"].grad.isfinite().all() and tensors["squeeze"].grad[0].any()
    assert not tensors["squeeze"].grad[1].any()


def test_absent_contacts_exert_nothing():
    tensors = pinch()
    present = torch.tensor([1.0, 1.0, 1.0, 0.0], dtype=torch.float64)
    padded = {
        name: value if name == "wrench" else torch.cat([value, torch.zeros_like(value[:1])])
        for name, value in tensors.items()
    }
    padded["normals"][3, 2] = 1.0
    solution = grasp_torch.closed_form(**padded, present=present)
    assert not solution.forces[3].any()
    torch.testing.assert_close(solution.forces[:3], grasp_torch.closed_form(**tensors).forces)


@KINDS
def test_memory_is_shared(dtype):
    tensor = torch.arange(96, dtype=dtype).reshape(32, 3)
    array = grasp_torch.to_jax(tensor)
    assert array.unsafe_buffer_pointer() == tensor.data_ptr()
    assert grasp_torch.to_torch(array).data_ptr() == tensor.data_ptr()
    # What is strided, or starts where XLA does not read, comes as a copy with the same numbers.
    np.testing.assert_array_equal(grasp_torch.to_jax(tensor.T), tensor.numpy().T)
    np.testing.assert_array_equal(grasp_torch.to_jax(tensor[1:]), tensor.numpy()[1:])


def test_what_was_written_over_since_has_no_gradient_rather_than_a_wrong_one():
    double = grasp_torch.from_jax(lambda x: (x**2, jnp.arange(3)))
    x = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64, requires_grad=True)
    squares, counts = double(x)
    squares.sum().backward()
    torch.testing.assert_close(x.grad, 2 * x.detach())
    assert counts.tolist() == [0, 1, 2] and not counts.requires_grad
    squares, _ = double(x)
    with torch.no_grad():
        x.mul_(2.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        squares.sum().backward()


def test_what_a_function_hands_through_has_memory_of_its_own():
    x = torch.ones(16, dtype=torch.float64)
    copied = grasp_torch.from_jax(lambda x: x)(x)
    assert copied.data_ptr() != x.data_ptr()
    torch.testing.assert_close(copied, x)


@pytest.mark.slow
def test_it_trains():
    """Squeezing forces that make the optimum's forces small, by PyTorch's optimiser."""
    tensors = pinch()
    squeeze = tensors.pop("squeeze").requires_grad_()
    optimiser = torch.optim.SGD([squeeze], lr=0.01)
    sizes = []
    for _ in range(20):
        optimiser.zero_grad()
        size = grasp_torch.constrained_optimum(squeeze=squeeze, **tensors).forces.square().sum()
        size.backward()
        optimiser.step()
        sizes.append(size.detach().item())
    assert (np.diff(sizes) < 0).all() and sizes[-1] < 0.99 * sizes[0]


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"points": [[0.0]]}, TypeError, "points is of type list: expected a torch tensor"),
        ({"wrench": np.zeros(6)}, TypeError, "an argument is of type ndarray: expected torch tensors"),
        ({"squeeze": "4"}, TypeError, "squeeze is of type str: expected a torch tensor"),
        (
            {"wrench": torch.zeros(6)},
            TypeError,
            "torch.float32 on cpu and torch.float64 on cpu: expected",
        ),
        ({"sharing": "all"}, ValueError, "sharing is 'all': expected 'squeeze' or 'uniform'"),
        ({"friction": torch.ones(2, dtype=torch.float64)}, ValueError, "friction"),
    ],
)
def test_wrong_arguments_are_named(unchecked, change, kind, message):
    with pytest.raises(kind, match=message):
        grasp_torch.constrained_optimum(**pinch() | change)


def test_doubles_without_jaxs_64_bit_mode_are_refused_and_pytorch_is_imported_late():
    code = (
        "import sys, jaxgrasp.interop.torch as t; assert 'torch' not in sys.modules\n"
        "import torch\n"
        "try: t.to_jax(torch.zeros(3, dtype=torch.float64))\n"
        "except ValueError as error: assert \"jax.config.update('jax_enable_x64', True)\" in str(error)\n"
        "else: raise SystemExit('float64 was taken')\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_pytorch_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgrasp\[torch\]'"):
        grasp_torch.from_jax(lambda x: x)


def test_whole_numbers_are_no_lengths():
    """Friction and squeeze of their kind would be zero."""
    points = torch.tensor([[1, 0, 0], [-1, 0, 0]], dtype=torch.int32)
    wrench = torch.tensor([0.0, 0, 1, 0, 0, 0])
    with pytest.raises(TypeError, match="points is of torch.int32: expected floats"):
        grasp_torch.constrained_optimum(points, -points, 0.5, 10.0, wrench)
    with pytest.raises(TypeError, match="squeeze is of torch.int64: expected floats"):
        grasp_torch.closed_form(points.float(), -points.float(), 0.5, torch.tensor([10, 10]), wrench)
